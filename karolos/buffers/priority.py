"""Prioritised experience replay: what surprised the critic most is seen most often.

Source: Schaul et al. 2016, "Prioritized Experience Replay", the proportional variant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting

from ..core import Batch, Buffer, Signature, State, Transitions
from ..core import Settings as BaseSettings
from ..core.seeding import SeedTree, generator_state, load_generator_state
from ..errors import RunError
from .hindsight import Hindsight
from .replay import Replay
from .storage import Slots
from .sum_tree import Numbers, SumTree

NEW_CALLS = 256
"""Calls of `add` after which new transitions enter the tree even if nobody samples."""


class Priority(Buffer):
    """Keeps the latest transitions of each environment and samples them by the size of their last error.

    P(i) = p_i / sum p with p = (|error| + epsilon)^alpha; a new transition has the largest p so far, so that each is
    seen soon. The loss of transition i weighs (N P(i))^-beta, divided by the largest weight of the batch; beta rises
    from `beta` to 1 over `beta_updates` batches. A batch is stratified: one transition from each of n equal shares.
    `Batch.slot` names a transition for good: a priority that comes after its slot was overwritten is dropped.

    Raises:
        UsageError: the capacity is less than one episode per environment, or hindsight is asked of an environment
            without goals.
    """

    class Settings(BaseSettings):
        capacity: int = Setting(1_000_000, ge=1, description="transitions kept, over all environments")
        alpha: float = Setting(0.6, ge=0, le=1, description="how much errors count for the odds; 0: not at all")
        beta: float = Setting(0.4, ge=0, le=1, description="how much weights make up for the odds, at the start")
        beta_updates: int = Setting(100_000, ge=1, description="batches after which beta has risen to 1")
        epsilon: float = Setting(1e-6, gt=0, description="added to each error, so that none is never seen again")
        hindsight: Hindsight.Settings | None = Setting(None, description="relabel goals when sampling; null: do not")
        n_step: int = Setting(1, ge=1, le=100, description="environment steps that a sampled transition spans at most")

    on_policy: ClassVar[bool] = False

    def __init__(
        self,
        settings: Priority.Settings,
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
        self._tree = SumTree(len(self._replay.storage.table))
        self._new: list[tuple[Slots, float]] = []
        self._largest = 1.0
        self._batches = 0
        self._generator = seeds.child("sample").generator()

    @property
    def beta(self) -> float:
        """How much weights make up for the odds, now."""
        start = self.settings.beta
        return start + (1 - start) * min(self._batches / self.settings.beta_updates, 1.0)

    def add(self, transitions: Transitions) -> None:
        """Store one transition of each environment named, with the largest priority. Raises as `Replay.add` does."""
        self._new.append((self._replay.add(transitions), self._largest))
        if len(self._new) >= NEW_CALLS:
            self._enter()

    def add_demonstrations(self, episodes: Sequence[Transitions], share: float | None = None) -> None:
        """Store demonstrations beside what the environments give, with the largest priority. Raises as `add` does."""
        self._enter()
        before = self._replay.storage.used()
        odds = self._tree[before]
        slots = self._replay.add_demonstrations(episodes, share)
        self._tree = SumTree(len(self._replay.storage.table))
        self._tree[np.concatenate((before, slots))] = np.concatenate((odds, np.full(slots.size, self._largest)))

    def _enter(self) -> None:
        """Enter new transitions into the tree; together, because each walk through it costs 40 us."""
        if self._new:
            slots, odds = zip(*self._new, strict=True)
            self._tree[np.concatenate(slots)] = np.repeat(odds, [part.size for part in slots])
            self._new.clear()

    def cut(self, environments: NDArray[np.int64]) -> None:
        """End the running episodes of these environments as they stand."""
        self._replay.storage.cut(environments)

    def sample(self, size: int) -> Batch:
        """`size` transitions; the arrays are views that the next call overwrites.

        Raises:
            RunError: nothing is stored yet.
        """
        self._replay.require_some()
        self._enter()
        slots, odds = self._draw(size)
        weights = (odds * len(self)) ** -self.beta
        self._batches += 1
        names = self._replay.storage.names(slots)
        return self._replay.batch(slots, (weights / weights.max()).astype(np.float32), names, self._generator)

    def _draw(self, size: int) -> tuple[Slots, Numbers]:
        """Slots by their priorities, and how likely each one was: (n,) both."""
        tree, storage, shown = self._tree, self._replay.storage, self._replay.shown(size)
        total, evenly = tree.total, np.arange(size) + self._generator.random(size)
        if shown is None:
            slots = tree.find(evenly * (total / size))
            return slots, tree[slots] / total
        # Two strata, each by its own priorities; demonstrations lie behind all else.
        others, border = size - shown, storage.environments * storage.lane_size
        before = tree.before(border)
        masses = evenly * (before / max(others, 1))
        masses[others:] = before + (evenly[others:] - others) * ((total - before) / max(shown, 1))
        slots = tree.find(masses)
        strata = np.where(slots < border, others / (size * max(before, 1e-300)), shown / (size * (total - before)))
        return slots, tree[slots] * strata

    def update_priorities(self, slot: NDArray[np.int64], priorities: Any) -> None:
        """Set the odds of a batch's transitions by their errors: (n,) non-negative, an array or a tensor.

        Raises:
            RunError: an error is not a number.
        """
        on_host = priorities.cpu() if hasattr(priorities, "cpu") else priorities
        errors = np.abs(np.asarray(on_host, np.float64))
        if not np.isfinite(errors).all():
            raise RunError("a transition's error is not a number", where="buffer", hint="lower agent.learning_rate")
        slots, there = self._replay.storage.resolve(slot)
        odds = (errors[there] + self.settings.epsilon) ** self.settings.alpha
        self._tree[slots[there]] = odds
        self._largest = max(self._largest, float(odds.max(initial=0.0)))

    def __len__(self) -> int:
        return len(self._replay.storage)

    def metrics(self) -> Mapping[str, float]:
        """How many transitions, the mean and the largest of their priorities p, and where beta stands."""
        self._enter()
        odds = self._tree[self._replay.storage.used()]
        return {
            "transitions": float(len(self)),
            "priority_mean": float(odds.mean()) if odds.size else 0.0,
            "priority_max": float(odds.max(initial=0.0)),
            "beta": self.beta,
        }

    def state(self) -> State:
        """The stored transitions with their odds, the generator and where beta stands; arrays are copies."""
        self._enter()
        return {
            "storage": self._replay.state(),
            "odds": self._tree[self._replay.storage.used()],
            "largest": self._largest,
            "batches": self._batches,
            "generator": generator_state(self._generator),
        }

    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of a buffer of another shape."""
        self._replay.load_state(state["storage"])
        self._new.clear()
        self._tree = SumTree(len(self._replay.storage.table))
        self._tree[self._replay.storage.used()] = np.asarray(state["odds"], np.float64)
        self._largest = float(state["largest"])
        self._batches = int(state["batches"])
        load_generator_state(self._generator, state["generator"])
