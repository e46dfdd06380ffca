"""A binary tree of sums over non-negative numbers, for sampling in proportion to them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.compiled import compiled

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
