"""Prioritised experience replay: transitions with large errors are sampled more often, by a tree of sums.

Source: Schaul et al. 2016, "Prioritized Experience Replay", the proportional variant.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting

from ..core import Batch, SeedTree, Signature, State
from ..core.compiled import compiled
from ..errors import RunError
from .replay import Replay
from .storage import Slots


class Priority(Replay):
    """A replay buffer that samples transitions in proportion to their priority.

    P(i) = p_i / sum p with p = (|error| + epsilon)^alpha. A new transition has the largest p so far. The importance
    weight of transition i is (N P(i))^-beta, divided by the largest weight of the batch; beta rises from `beta` to 1
    over `beta_updates` batches. A batch is stratified: one transition from each of n equal parts of the total priority.
    With a share of demonstrations, P and N are those among the demonstrations, or among the other transitions: weights
    correct the sampling by priority, and demonstrations keep their share of the loss. The share is exact on average
    when beta is 1. With P and N of the whole buffer, weights would undo the share of a few demonstrations among many.
    `Batch.slot` identifies a transition, not a slot: the priority of an overwritten transition is ignored.
    """

    class Settings(Replay.Settings):
        alpha: float = Setting(0.6, ge=0, le=1, description="exponent of the errors in the priorities; 0: uniform")
        beta: float = Setting(0.4, ge=0, le=1, description="initial exponent of the importance weights")
        beta_updates: int = Setting(100_000, ge=1, description="batches over which beta rises to 1")
        epsilon: float = Setting(1e-6, gt=0, description="added to each error, so that every transition can be sampled")

    settings: Priority.Settings

    def __init__(
        self, settings: Priority.Settings, signature: Signature, seeds: SeedTree, *, environments: int, discount: float
    ) -> None:
        super().__init__(settings, signature, seeds, environments=environments, discount=discount)
        self.settings = settings
        self._tree = SumTree(len(self.storage.table))
        self._largest = 1.0
        self._batches = 0

    @property
    def beta(self) -> float:
        """The current exponent of the importance weights."""
        start = self.settings.beta
        return start + (1 - start) * min(self._batches / self.settings.beta_updates, 1.0)

    def _added(self, slots: Slots) -> None:
        """New transitions get the largest priority."""
        size, before = len(self.storage.table), self._tree
        if size > before.size:  # demonstrations come after all other slots
            self._tree = SumTree(size)
            self._tree[np.arange(before.size)] = before[np.arange(before.size)]
        self._tree[slots] = self._largest

    def sample(self, size: int) -> Batch:
        """`size` transitions; the arrays are views that the next call overwrites. Raises RunError if it is empty."""
        slots, relative = self._draw(size)
        weights = relative**-self.beta
        self._batches += 1
        return self._batch(slots, (weights / weights.max()).astype(np.float32), self.storage.identifiers(slots))

    def _draw(self, size: int) -> tuple[Slots, Numbers]:
        """Slots sampled by their priorities, and each one's priority relative to the mean, N P(i): (n,) both."""
        tree, demonstrated = self._tree, self._demonstrated_count(size)
        total, strata = tree.total, np.arange(size) + self._generator.random(size)
        if demonstrated is None:
            slots = tree.find(strata * (total / size))
            return slots, tree[slots] * (len(self) / total)
        # First the environments' transitions are sampled, then demonstrations, which have the last slots.
        others, first_slot = size - demonstrated, self.storage.environments * self.storage.ring_size
        mass = tree.before(first_slot)
        masses = strata * (mass / max(others, 1))
        masses[others:] = mass + (strata[others:] - others) * ((total - mass) / max(demonstrated, 1))
        slots = tree.find(masses)
        stored = self.storage.demonstrations
        scale = np.where(slots < first_slot, (len(self) - stored) / max(mass, 1e-300), stored / (total - mass))
        return slots, tree[slots] * scale

    def update_priorities(self, slot: NDArray[np.int64], priorities: Any) -> None:
        """Set the priorities of a batch's transitions from their errors: (n,) non-negative, an array or a tensor.

        Raises:
            RunError: an error is not a finite number.
        """
        on_host = priorities.cpu() if hasattr(priorities, "cpu") else priorities
        errors = np.abs(np.asarray(on_host, np.float64))
        if not np.isfinite(errors).all():
            raise RunError("a transition's error is not a number", setting="buffer", hint="lower agent.learning_rate")
        slots, stored = self.storage.resolve(slot)
        numbers = (errors[stored] + self.settings.epsilon) ** self.settings.alpha
        self._tree[slots[stored]] = numbers
        self._largest = max(self._largest, float(numbers.max(initial=0.0)))

    def metrics(self) -> Mapping[str, float]:
        """Number of transitions, mean and largest priority p, and beta."""
        priorities = self._tree[self.storage.used()]
        return {
            **super().metrics(),
            "priority_mean": float(priorities.mean()) if priorities.size else 0.0,
            "priority_max": float(priorities.max(initial=0.0)),
            "beta": self.beta,
        }

    def state(self) -> State:
        """The stored transitions with their priorities, the generator and the position of beta; arrays are copies."""
        return {
            **super().state(),
            "odds": self._tree[self.storage.used()],
            "largest": self._largest,
            "beta_batches": self._batches,
        }

    def load_state(self, state: State) -> None:
        """Load a state. Raises UsageError if it belongs to a buffer of another shape."""
        super().load_state(state)
        self._tree = SumTree(len(self.storage.table))
        self._tree[self.storage.used()] = np.asarray(state["odds"], np.float64)
        self._largest = float(state["largest"])
        self._batches = int(state["beta_batches"])


Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]


class SumTree:
    """`size` numbers, initially 0. Changing or finding n of them takes O(n log size), in compiled code.

    The tree is one array: node i has the children 2 i and 2 i + 1, node 1 is the root, and the last level holds the
    numbers. Each change recomputes a node from its two children, so rounding errors do not accumulate.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._first = 1 << max(int(size - 1).bit_length(), 1)
        self._nodes = np.zeros(2 * self._first, np.float64)

    @property
    def total(self) -> float:
        return float(self._nodes[1])

    def __getitem__(self, indices: Indices) -> Numbers:
        """The numbers at these indices: (n,), a copy."""
        numbers: Numbers = self._nodes[indices + self._first]
        return numbers

    def __setitem__(self, indices: Indices, numbers: Numbers | float) -> None:
        """Change the numbers at these indices (n,). The last value counts for a repeated index."""
        leaves = indices + self._first
        self._nodes[leaves] = numbers
        _sum_up(self._nodes, leaves)

    def before(self, index: int) -> float:
        """The sum of the numbers before this index."""
        node, total = index + self._first, 0.0
        while node > 1:
            if node & 1:
                total += float(self._nodes[node - 1])
            node >>= 1
        return total

    def find(self, masses: Numbers) -> Indices:
        """For each mass in [0, total), (n,): the index i with sum(numbers[:i]) <= mass < sum(numbers[:i + 1]).

        The number at i is never 0, also after rounding. At least one number must be larger than 0.
        """
        leaves = np.empty(masses.size, np.int64)
        _descend(self._nodes, masses.astype(np.float64), leaves)
        leaves -= self._first
        return leaves


@compiled
def _sum_up(nodes: Any, leaves: Any) -> None:
    """Recompute the nodes above these leaves, (n,)."""
    for leaf in leaves:
        node = leaf >> 1
        while node:
            nodes[node] = nodes[2 * node] + nodes[2 * node + 1]
            node >>= 1


@compiled
def _descend(nodes: Any, masses: Any, leaves: Any) -> None:
    """Write the leaf under which each of the masses (n,) falls into `leaves` (n,). Overwrites `masses`."""
    leaves[:] = 1
    level = len(nodes) // 2
    while level > 1:  # all rows level by level, because the processor then waits for several of them at a time
        for row in range(len(masses)):
            node = 2 * leaves[row]
            left = nodes[node]
            # Rounding must not lead into a branch whose sum is 0.
            goes_right = ((masses[row] >= left) & (nodes[node + 1] > 0)) | (left <= 0)
            masses[row] -= left * goes_right
            leaves[row] = node + goes_right
        level //= 2
