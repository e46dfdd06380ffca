"""A binary tree of sums over non-negative numbers, for sampling in proportion to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

UNIQUE_ABOVE = 256
"""Number of nodes above which it is faster to remove duplicates: neighbours have the same parent."""


class SumTree:
    """`size` numbers, initially 0. Changing or finding n of them takes O(n log size), vectorised over n.

    The tree is one array: node i has the children 2 i and 2 i + 1, node 1 is the root, and the last level holds the
    numbers. Each change recomputes a node from its two children, so rounding errors do not accumulate.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._levels = max(int(size - 1).bit_length(), 1)
        self._first = 1 << self._levels
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
        nodes = indices + self._first
        self._nodes[nodes] = numbers
        take = self._nodes.take
        for _ in range(self._levels):
            nodes = nodes >> 1
            if nodes.size > UNIQUE_ABOVE:
                nodes = np.unique(nodes)
            left = nodes << 1
            self._nodes[nodes] = take(left, mode="clip") + take(left + 1, mode="clip")

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
        nodes = np.ones(masses.size, np.int64)
        left_over = masses.astype(np.float64)
        left = np.empty_like(left_over)
        for _ in range(self._levels):
            nodes <<= 1
            np.take(self._nodes, nodes, out=left, mode="clip")  # "clip" skips the bounds check; every index is valid
            goes_right = left_over >= left
            left_over -= np.multiply(left, goes_right, out=left)
            nodes += goes_right
        empty = self._nodes[nodes] <= 0  # rounding led past the last number of a branch
        if empty.any():
            nodes[empty] = self._find_positive(masses[empty])
        return nodes - self._first

    def _find_positive(self, masses: Numbers) -> Indices:
        """Like `find`, but never enters a branch whose sum is 0. Returns nodes."""
        nodes = np.ones(masses.size, np.int64)
        left_over = masses.astype(np.float64)
        for _ in range(self._levels):
            nodes = 2 * nodes
            left, right = self._nodes[nodes], self._nodes[nodes + 1]
            goes_right = ((left_over >= left) & (right > 0)) | (left <= 0)
            left_over = np.where(goes_right, left_over - left, left_over)
            nodes += goes_right
        return nodes
