"""What replay buffers share: transitions in a table, goals relabelled when sampled, rows handed out as a batch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..core import Batch, FloatArray, Signature, State, Transitions
from ..errors import RunError
from .hindsight import Hindsight
from .n_step import NStep
from .storage import Slots, Storage

NOTHING = np.zeros(0, np.int64)


class Replay:
    """A storage, hindsight and multi-step returns if asked for; which slots a batch takes is the buffer's own business.

    Args:
        signature: of the environments.
        capacity: transitions kept, over all environments.
        hindsight: what to relabel with; None: nothing.
        n_step: steps that a transition of a batch spans at most.
        environments: how many fill it.
        discount: per environment step.

    Raises:
        UsageError: the capacity is less than one episode per environment, or there are no goals to relabel.
    """

    def __init__(
        self,
        signature: Signature,
        *,
        capacity: int,
        hindsight: Hindsight.Settings | None,
        n_step: int,
        environments: int,
        discount: float,
    ) -> None:
        self._hindsight = Hindsight(hindsight, signature) if hindsight is not None else None
        self.storage = Storage(signature, capacity, environments)
        self._n_step = NStep(n_step, discount, self.storage, signature.goal_rule) if n_step > 1 else None
        self._discount = np.float32(discount)
        self._discounts = np.zeros(0, np.float32)
        self._share: float | None = None

    def shown(self, size: int) -> int | None:
        """How many of a batch's rows have to be demonstrations; None: as it comes.

        All of them while nothing else is stored, none where there are none.
        """
        if self._share is None:
            return None
        if not self.storage.kept:
            return 0
        return size if self.storage.kept == len(self.storage) else round(self._share * size)

    def add(self, transitions: Transitions) -> Slots:
        """Store one transition of each environment named; where they went.

        Raises:
            PluginError: with hindsight, when rewards are not those of the environment's goal rule.
        """
        if self._hindsight is not None:
            self._hindsight.check(transitions)
        return self.storage.add(transitions)

    def add_demonstrations(self, episodes: Sequence[Transitions], share: float | None) -> Slots:
        """Store demonstrations where nothing overwrites them; where they went. Raises as `add` does."""
        self._share = share
        if self._hindsight is not None:
            for episode in episodes:
                self._hindsight.check(episode)
        return self.storage.add_demonstrations(episodes)

    def require_some(self) -> None:
        """Raise a RunError while nothing is stored."""
        if not len(self.storage):
            raise RunError("the buffer is empty; nothing can be sampled", where="buffer", hint="add transitions first")

    def batch(self, slots: Slots, weights: FloatArray, names: Slots, generator: np.random.Generator) -> Batch:
        """The transitions at these slots, some with new goals; the arrays are views that the next call overwrites.

        Args:
            slots: (n,).
            weights: of their losses, (n,).
            names: what `Batch.slot` calls them, (n,).
            generator: draws the goals.
        """
        rows = self.storage.gather(slots)
        relabelled = NOTHING
        if self._hindsight is not None:
            relabelled = self._hindsight.relabel(rows, slots, self.storage, generator)
        if self._n_step is not None:
            self._discounts = self._n_step.extend(rows, slots, relabelled)
        elif self._discounts.size != slots.size:
            self._discounts = np.full(slots.size, self._discount, np.float32)
        return Batch(
            observation=rows["observation"],
            desired_goal=rows["desired_goal"],
            action=rows["action"],
            reward=rows.number("reward"),
            next_observation=rows["next_observation"],
            terminated=rows.number("terminated"),
            discount=self._discounts,
            weight=weights,
            slot=names,
            demonstrated=self.storage.demonstrated(slots),
        )

    def state(self) -> State:
        return {**self.storage.state(), "share": self._share}

    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of a buffer of another shape."""
        self.storage.load_state(state)
        self._share = state.get("share")  # checkpoints of karolos 0.1 before demonstrations.share have none
