"""What an on-policy agent has just played, each transition once: first in, first out, without replacement."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting

from ..core import Buffer, Rollout, Signature, State, Transitions
from ..core import Settings as BaseSettings
from ..core.seeding import SeedTree
from ..errors import RunError, UsageError


class OnPolicy(Buffer[Rollout]):
    """Collects `rollout` transitions of each environment, gives them away as one rollout, and begins anew.

    A rollout is complete as soon as one environment has all of its transitions. Others may have fewer: where a
    simulation diverged, a step is missing. Episodes go on from one rollout to the next.
    """

    class Settings(BaseSettings):
        rollout: int = Setting(128, ge=1, le=1_000_000, description="steps of each environment between two updates")

    on_policy: ClassVar[bool] = True

    def __init__(
        self,
        settings: OnPolicy.Settings,
        signature: Signature,
        seeds: SeedTree,  # noqa: ARG002 (draws nothing)
        *,
        environments: int,
        discount: float,  # noqa: ARG002 (returns are the agent's business)
    ) -> None:
        self.settings = settings
        size = settings.rollout, environments

        def wide(columns: int) -> NDArray[np.float32]:
            return np.zeros((*size, columns), np.float32)

        self._rows = Rollout(
            observation=wide(signature.observation.size),
            desired_goal=wide(signature.desired_goal.size),
            action=wide(signature.action.size),
            reward=np.zeros(size, np.float32),
            next_observation=wide(signature.observation.size),
            terminated=np.zeros(size, np.bool_),
            ended=np.zeros(size, np.bool_),
            stored=np.zeros(size, np.bool_),
        )
        self._count = np.zeros(environments, np.int64)
        """Transitions of each environment so far."""

    def add(self, transitions: Transitions) -> None:
        """Store one transition of each environment named, in any order, any subset.

        Raises RunError when the rollout is complete and nobody has taken it.
        """
        if len(self):
            raise RunError("a rollout is complete, and nobody has taken it", where="buffer")
        lanes = transitions.environment
        places = self._count[lanes], lanes
        rows = self._rows
        for name in ("observation", "desired_goal", "action", "reward", "next_observation", "terminated"):
            getattr(rows, name)[places] = getattr(transitions, name)
        rows.ended[places] = transitions.terminated | transitions.truncated
        self._count[lanes] += 1

    def cut(self, environments: NDArray[np.int64]) -> None:
        """End the running episodes of these environments as they stand, as if their time were up."""
        lanes = environments[self._count[environments] > 0]
        self._rows.ended[self._count[lanes] - 1, lanes] = True

    def sample(self, size: int) -> Rollout:
        """The rollout, once. Its arrays are valid until the next `add`.

        Raises:
            RunError: it is not complete.
            ValueError: `size` is not the number of its transitions.
        """
        if not len(self):
            raise RunError("the rollout is not complete yet", where="buffer", hint="add more transitions first")
        if size != len(self):
            raise ValueError(f"a rollout is given as a whole: {len(self)} transitions, not {size}")
        given = self._rows
        lanes = np.flatnonzero(self._count)
        given.ended[self._count[lanes] - 1, lanes] = True  # what comes next comes with the next rollout
        given.stored[:] = np.arange(self.settings.rollout)[:, None] < self._count
        self._count[:] = 0
        return given

    def __len__(self) -> int:
        return int(self._count.sum()) if self._count.max() == self.settings.rollout else 0

    def state(self) -> State:
        """The rollout as far as it has come; arrays are copies."""
        used = int(self._count.max())
        rows = {name: array[:used].copy() for name, array in self._rows._asdict().items()}
        return {"rows": rows, "count": self._count.copy()}

    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of a buffer of another shape."""
        rows, count = state["rows"], np.asarray(state["count"])
        fits = all(
            np.asarray(rows[name]).shape[1:] == array.shape[1:] and len(rows[name]) <= len(array)
            for name, array in self._rows._asdict().items()
        )
        if not fits or count.shape != self._count.shape:
            raise UsageError(
                "the stored buffer has another number of environments, rollout or kind of transition",
                where="buffer",
                hint="resume with the spec the run was started with",
            )
        for name, array in self._rows._asdict().items():
            array[: len(rows[name])] = rows[name]
        self._count[:] = count
