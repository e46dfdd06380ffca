"""Which transitions a batch takes. A sampler knows slots and their odds, nothing of what lies there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..core import FloatArray
from .storage import Slots, Storage


class Drawn(NamedTuple):
    """Slots of a batch, and what each one's loss weighs: (n,) both."""

    slots: Slots
    weights: FloatArray


class UniformSampler:
    """Every stored transition is equally likely, with replacement, and weighs 1."""

    def __init__(self) -> None:
        self._ones = np.ones(0, np.float32)

    def draw(self, size: int, storage: Storage, generator: np.random.Generator) -> Drawn:
        """`size` slots that hold something."""
        ends = np.cumsum(storage.filled)
        ranks = generator.integers(0, ends[-1], size)
        lanes = np.searchsorted(ends, ranks, side="right")
        # A lane fills from its first row on, so the k-th transition of a lane lies in its k-th row.
        slots = ranks + (np.arange(storage.lanes) * storage.lane_size - ends + storage.filled)[lanes]
        if self._ones.size != size:
            self._ones = np.ones(size, np.float32)
        return Drawn(slots, self._ones)
