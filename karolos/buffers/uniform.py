"""Experience replay with uniform sampling (Lin 1992; Mnih et al. 2015)."""

from __future__ import annotations

import numpy as np

from ..core import Batch
from .replay import Replay


class Uniform(Replay):
    """A replay buffer that samples each stored transition with equal probability, with replacement."""

    def sample(self, size: int) -> Batch:
        """`size` transitions; the arrays are views that the next call overwrites. Raises RunError if it is empty."""
        demonstrated, draw = self._demonstrated_count(size), self._generator.integers
        if demonstrated is None:
            ranks = draw(0, len(self), size)
        else:  # demonstrations have the last ranks
            others = len(self) - self.storage.demonstrations
            ranks = np.concatenate(
                (draw(0, max(others, 1), size - demonstrated), draw(others, len(self), demonstrated))
            )
        slots = self.storage.at(ranks)
        return self._batch(slots, np.ones(size, np.float32), slots)
