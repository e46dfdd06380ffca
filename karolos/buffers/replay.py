"""The base of replay buffers: storage, hindsight and augmentation at sampling, multi-step returns, demonstrations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting

from ..core import (
    Batch,
    Buffer,
    FloatArray,
    SeedTree,
    Signature,
    State,
    Transitions,
    generator_state,
    load_generator_state,
)
from ..core import Settings as BaseSettings
from ..errors import RunError
from .augmentation import Augmentation
from .hindsight import Hindsight, extend
from .storage import Slots, Storage


class Replay(Buffer):
    """Stores the latest transitions of each environment. A subclass samples: it chooses slots and calls `_batch`.

    Transitions of running episodes can be sampled. With `hindsight`, some transitions of a batch get goals that the
    same episode achieved; with `augmentation` they are mirrored and moved.

    Raises:
        UsageError: the capacity is below one episode per environment, or `hindsight` is set for an environment
            without goals, or `augmentation` for one with fields of unknown kind.
    """

    class Settings(BaseSettings):
        capacity: int = Setting(
            1_000_000, ge=1, le=10**12, description="largest number of transitions, over all environments"
        )
        hindsight: Hindsight.Settings | None = Setting(None, description="replaces goals when sampling; null: off")
        augmentation: Augmentation.Settings | None = Setting(
            None, description="mirrors and moves sampled transitions; null: off"
        )
        n_step: int = Setting(1, ge=1, le=100, description="most environment steps of a sampled transition")

    on_policy: ClassVar[bool] = False

    def __init__(
        self, settings: Replay.Settings, signature: Signature, seeds: SeedTree, *, environments: int, discount: float
    ) -> None:
        hindsight = settings.hindsight
        self.capacity = settings.capacity
        self.marks_relabelled = hindsight is not None and hindsight.imitate
        self.storage = Storage(signature, settings.capacity, environments)
        self._hindsight = Hindsight(hindsight, signature) if hindsight is not None else None
        augmentation = settings.augmentation
        self._augmentation = Augmentation(augmentation, signature) if augmentation is not None else None
        self._signature, self._n_step, self._discount = signature, settings.n_step, discount
        self._discounts = np.zeros(0, np.float32)
        self._share: float | None = None
        self._generator = seeds.child("sample").generator()

    def add(self, transitions: Transitions) -> None:
        """Store at most one transition of each environment.

        Raises:
            PluginError: with hindsight, the rewards are not those of the environment's goal rule.
        """
        if self._hindsight is not None:
            self._hindsight.check(transitions)
        self._added(self.storage.add(transitions))

    def add_demonstrations(self, episodes: Sequence[Transitions], share: float | None = None) -> None:
        """Store demonstrations permanently. Raises as `add` does."""
        self._share = share
        if self._hindsight is not None:
            for episode in episodes:
                self._hindsight.check(episode)
        self._added(self.storage.add_demonstrations(episodes))

    def _added(self, slots: Slots) -> None:
        """Hook for subclasses: new transitions are stored in these slots."""

    def cut(self, environments: NDArray[np.int64]) -> None:
        """End the running episodes of these environments."""
        self.storage.cut(environments)

    def _demonstrated_count(self, size: int) -> int | None:
        """Number of demonstrated transitions in a batch; None without a fixed share or without demonstrations.

        All while only demonstrations are stored. Raises RunError while the buffer is empty.
        """
        self._require_transitions()
        if self._share is None or not self.storage.demonstrations:
            return None
        return size if self.storage.demonstrations == len(self.storage) else round(self._share * size)

    def _require_transitions(self) -> None:
        """Raise a RunError while the buffer is empty. Buffers of plugins call it, too."""
        if not len(self):
            raise RunError("the buffer is empty", setting="buffer", hint="add transitions before sampling")

    def _batch(self, slots: Slots, weights: FloatArray, identifiers: Slots) -> Batch:
        """The transitions at these slots as a batch, partly with new goals; the next call overwrites the arrays.

        Args:
            weights: importance weights of their losses, (n,).
            identifiers: the numbers in `Batch.slot`, (n,).
        """
        stored = self.storage.gather(slots)
        relabelled = np.zeros(0, np.int64)
        if self._hindsight is not None:
            relabelled = self._hindsight.relabel(stored, slots, self.storage, self._generator)
        if self._n_step > 1:
            self._discounts = extend(
                stored,
                slots,
                relabelled,
                self.storage,
                self._signature,
                steps=self._n_step,
                discount=self._discount,
            )
        elif self._discounts.size != slots.size:
            self._discounts = np.full(slots.size, self._discount, np.float32)
        if self._augmentation is not None:
            self._augmentation.apply(stored, self._generator)
        demonstrated = self.storage.demonstrated(slots)
        if self.marks_relabelled:
            demonstrated = np.zeros(slots.size, np.float32) if demonstrated is None else demonstrated
            demonstrated[relabelled] = 1
        return Batch(
            observation=stored["observation"],
            desired_goal=stored["desired_goal"],
            action=stored["action"],
            reward=stored["reward"],
            next_observation=stored["next_observation"],
            terminated=stored["terminated"],
            discount=self._discounts,
            weight=weights,
            slot=identifiers,
            demonstrated=demonstrated,
        )

    def __len__(self) -> int:
        return len(self.storage)

    def metrics(self) -> Mapping[str, float]:
        return {"transitions": float(len(self))}

    def state(self) -> State:
        """The stored transitions and the generator; arrays are copies."""
        storage = {**self.storage.state(), "share": self._share}
        batches = 0 if self._augmentation is None else self._augmentation.batches
        return {"storage": storage, "generator": generator_state(self._generator), "batches": batches}

    def load_state(self, state: State) -> None:
        """Load a state. Raises UsageError if it belongs to a buffer of another shape."""
        self.storage.load_state(state["storage"])
        share = state["storage"]["share"]
        self._share = None if share is None else float(share)
        if self._augmentation is not None:
            self._augmentation.batches = state["batches"]
        load_generator_state(self._generator, state["generator"])
