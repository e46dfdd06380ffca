"""Experience replay with equal odds (Lin 1992; Mnih et al. 2015)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting

from ..core import Batch, Buffer, Signature, State, Transitions
from ..core import Settings as BaseSettings
from ..core.seeding import SeedTree, generator_state, load_generator_state
from .hindsight import Hindsight
from .replay import Replay


class Uniform(Buffer):
    """Keeps the latest transitions of each environment; each is equally likely in a batch, with replacement.

    Transitions of episodes that still run can be sampled. With `hindsight` a share of each batch gets goals that the
    same episode achieved.

    Raises:
        UsageError: the capacity is less than one episode per environment, or hindsight is asked of an environment
            without goals.
    """

    class Settings(BaseSettings):
        capacity: int = Setting(1_000_000, ge=1, description="transitions kept, over all environments")
        hindsight: Hindsight.Settings | None = Setting(None, description="relabel goals when sampling; null: do not")
        n_step: int = Setting(1, ge=1, le=100, description="environment steps that a sampled transition spans at most")

    on_policy: ClassVar[bool] = False

    def __init__(
        self,
        settings: Uniform.Settings,
        signature: Signature,
        seeds: SeedTree,
        *,
        environments: int,
        discount: float,
    ) -> None:
        self.settings = settings
        self._replay = Replay(
            signature,
            capacity=settings.capacity,
            hindsight=settings.hindsight,
            n_step=settings.n_step,
            environments=environments,
            discount=discount,
        )
        self._generator = seeds.child("sample").generator()
        self._ones = np.ones(0, np.float32)

    def add(self, transitions: Transitions) -> None:
        """Store one transition of each environment named, in any order, any subset. Raises as `Replay.add` does."""
        self._replay.add(transitions)

    def add_demonstrations(self, episodes: Sequence[Transitions], share: float | None = None) -> None:
        """Store demonstrations beside what the environments give. Raises as `Replay.add` does."""
        self._replay.add_demonstrations(episodes, share)

    def cut(self, environments: NDArray[np.int64]) -> None:
        """End the running episodes of these environments as they stand."""
        self._replay.storage.cut(environments)

    def sample(self, size: int) -> Batch:
        """`size` transitions with replacement; the arrays are views that the next call overwrites.

        Raises:
            RunError: nothing is stored yet.
        """
        self._replay.require_some()
        storage, shown, draw = self._replay.storage, self._replay.shown(size), self._generator.integers
        if shown is None:
            ranks = draw(0, len(self), size)
        else:
            others = len(self) - storage.kept
            ranks = np.concatenate((draw(0, max(others, 1), size - shown), draw(others, max(len(self), 1), shown)))
        slots = storage.at(ranks)
        if self._ones.size != size:
            self._ones = np.ones(size, np.float32)
        return self._replay.batch(slots, self._ones, slots, self._generator)

    def __len__(self) -> int:
        return len(self._replay.storage)

    def metrics(self) -> Mapping[str, float]:
        return {"transitions": float(len(self))}

    def state(self) -> State:
        """The stored transitions and the generator; arrays are copies."""
        return {"storage": self._replay.state(), "generator": generator_state(self._generator)}

    def load_state(self, state: State) -> None:
        self._replay.load_state(state["storage"])
        load_generator_state(self._generator, state["generator"])
