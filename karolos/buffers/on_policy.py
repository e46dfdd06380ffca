"""The buffer of on-policy agents: complete rollouts, each used once."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting

from ..core import Buffer, Rollout, SeedTree, Signature, State, Transitions
from ..core import Settings as BaseSettings
from ..errors import RunError, UsageError


class OnPolicy(Buffer[Rollout]):
    """Collects `rollout` transitions of each environment, returns them as one Rollout, and starts the next.

    A rollout is complete as soon as one environment has all of its transitions. Other environments may have fewer,
    because a step is missing where a simulation diverged. Episodes continue from one rollout to the next.
    """

    class Settings(BaseSettings):
        rollout: int = Setting(128, ge=1, le=1_000_000, description="steps of each environment per rollout")

    on_policy: ClassVar[bool] = True

    def __init__(
        self,
        settings: OnPolicy.Settings,
        signature: Signature,
        seeds: SeedTree,  # noqa: ARG002 (draws nothing)
        *,
        environments: int,
        discount: float,  # noqa: ARG002 (the agent computes returns)
    ) -> None:
        self.settings = settings
        size = settings.rollout, environments
        self.capacity = settings.rollout * environments

        def wide(columns: int) -> NDArray[np.float32]:
            return np.zeros((*size, columns), np.float32)

        self._rollout = Rollout(
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
        """Transitions of each environment in this rollout."""

    def add(self, transitions: Transitions) -> None:
        """Store at most one transition of each environment. Raises RunError while a complete rollout is not sampled."""
        if len(self):
            raise RunError("the rollout is complete and was not sampled", setting="buffer")
        environments = transitions.environment
        places = self._count[environments], environments
        rollout = self._rollout
        for name in ("observation", "desired_goal", "action", "reward", "next_observation", "terminated"):
            getattr(rollout, name)[places] = getattr(transitions, name)
        rollout.ended[places] = transitions.terminated | transitions.truncated
        self._count[environments] += 1

    def cut(self, environments: NDArray[np.int64]) -> None:
        """Truncate the running episodes of these environments."""
        started = environments[self._count[environments] > 0]
        self._rollout.ended[self._count[started] - 1, started] = True

    def sample(self, size: int) -> Rollout:
        """The rollout, once. Its arrays are valid until the next `add`.

        Raises:
            RunError: the rollout is not complete.
            ValueError: `size` is not the number of its transitions.
        """
        if not len(self):
            raise RunError("the rollout is not complete yet", setting="buffer", hint="add more transitions first")
        if size != len(self):
            raise ValueError(f"a rollout is sampled as a whole: {len(self)} transitions, not {size}")
        rollout = self._rollout
        started = np.flatnonzero(self._count)
        rollout.ended[self._count[started] - 1, started] = True  # the next transition belongs to the next rollout
        rollout.stored[:] = np.arange(self.settings.rollout)[:, None] < self._count
        self._count[:] = 0
        return rollout

    def __len__(self) -> int:
        return int(self._count.sum()) if self._count.max() == self.settings.rollout else 0

    def state(self) -> State:
        """The transitions so far; arrays are copies."""
        used = int(self._count.max())
        stored = {name: array[:used].copy() for name, array in self._rollout._asdict().items()}
        return {"rows": stored, "count": self._count.copy()}

    def load_state(self, state: State) -> None:
        """Load a state. Raises UsageError if it belongs to a buffer of another shape."""
        stored, count = state["rows"], np.asarray(state["count"])
        fits = all(
            np.asarray(stored[name]).shape[1:] == array.shape[1:] and len(stored[name]) <= len(array)
            for name, array in self._rollout._asdict().items()
        )
        if not fits or count.shape != self._count.shape:
            raise UsageError(
                "the stored buffer has another number of environments, rollout or kind of transition",
                setting="buffer",
                hint="resume with the spec the run was started with",
            )
        for name, array in self._rollout._asdict().items():
            array[: len(stored[name])] = stored[name]
        self._count[:] = count
