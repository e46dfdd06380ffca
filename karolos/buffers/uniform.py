"""Experience replay with equal odds (Lin 1992; Mnih et al. 2015)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting

from ..core import Batch, Buffer, Signature, State, Transitions
from ..core import Settings as BaseSettings
from ..errors import RunError
from ..seeding import SeedTree, generator_state, load_generator_state
from .hindsight import Hindsight
from .sampling import UniformSampler
from .storage import Storage


class Uniform(Buffer):
    """Keeps the latest transitions of each environment; each is equally likely in a batch.

    Transitions of episodes that still run can be sampled. With `hindsight` a share of each batch gets goals that the
    same episode achieved.

    Raises:
        UsageError: the capacity is less than one episode per environment, or hindsight is asked of an environment
            without goals.
    """

    class Settings(BaseSettings):
        capacity: int = Setting(1_000_000, ge=1, description="transitions kept, over all environments")
        hindsight: Hindsight.Settings | None = Setting(None, description="relabel goals when sampling; null: do not")

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
        self._hindsight = Hindsight(settings.hindsight, signature) if settings.hindsight is not None else None
        self._storage = Storage(signature, settings.capacity, environments)
        self._sampler = UniformSampler()
        self._generator = seeds.child("sample").generator()
        self._discount = np.float32(discount)
        self._discounts = np.zeros(0, np.float32)

    def add(self, transitions: Transitions) -> None:
        """Store one transition of each environment named, in any order, any subset.

        Raises:
            PluginError: with hindsight, when rewards are not those of the environment's goal rule.
        """
        if self._hindsight is not None:
            self._hindsight.check(transitions)
        self._storage.add(transitions)

    def cut(self, environments: NDArray[np.int64]) -> None:
        """End the running episodes of these environments as they stand."""
        self._storage.cut(environments)

    def sample(self, size: int) -> Batch:
        """`size` transitions with replacement; the arrays are views that the next call overwrites.

        Raises:
            RunError: nothing is stored yet.
        """
        if not len(self):
            raise RunError("the buffer is empty; nothing can be sampled", where="buffer", hint="add transitions first")
        slots, weights = self._sampler.draw(size, self._storage, self._generator)
        rows = self._storage.gather(slots)
        if self._hindsight is not None:
            self._hindsight.relabel(rows, slots, self._storage, self._generator)
        if self._discounts.size != size:
            self._discounts = np.full(size, self._discount, np.float32)
        return Batch(
            observation=rows["observation"],
            desired_goal=rows["desired_goal"],
            action=rows["action"],
            reward=rows.number("reward"),
            next_observation=rows["next_observation"],
            terminated=rows.number("terminated"),
            discount=self._discounts,
            weight=weights,
            slot=slots,
        )

    def __len__(self) -> int:
        return len(self._storage)

    def state(self) -> State:
        """The stored transitions and the generator; arrays are copies."""
        return {"storage": self._storage.state(), "generator": generator_state(self._generator)}

    def load_state(self, state: State) -> None:
        self._storage.load_state(state["storage"])
        load_generator_state(self._generator, state["generator"])
