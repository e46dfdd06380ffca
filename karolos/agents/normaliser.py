"""Inputs at about zero mean and unit spread, whatever their units."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core import State

CLIP = 5.0
"""Normalised inputs are cut here, if nothing else is said. Source: OpenAI baselines, HER (norm_clip)."""
SMALLEST_SPREAD = 0.01
"""A column that hardly varies is not blown up further than this. Source: OpenAI baselines, HER (norm_eps)."""


class Normaliser:
    """Running mean and spread of columns, over all rows it was shown (Chan et al. 1979 for the merging).

    `update` is for learning only: acting and tests leave the statistics as they are. All of it lies in tensors that
    stay where they are, so that an update can be captured.

    Args:
        columns: how many.
        device: where the statistics live.
        clip: normalised columns are cut to +- this.
    """

    def __init__(self, columns: int, device: str, *, clip: float = CLIP) -> None:
        self.clip = clip
        self._count = torch.zeros((), dtype=torch.float64, device=device)
        self.mean = torch.zeros(columns, dtype=torch.float64, device=device)
        self._squares = torch.zeros(columns, dtype=torch.float64, device=device)
        self._shift = torch.zeros(columns, device=device)
        self._scale = torch.ones(columns, device=device)

    @property
    def count(self) -> int:
        """Rows shown so far."""
        return int(self._count)

    @property
    def spread(self) -> Tensor:
        """Standard deviation of each column, at least SMALLEST_SPREAD; 1 before the first update."""
        spread = (self._squares / self._count.clamp(min=1)).sqrt_().clamp_(min=SMALLEST_SPREAD)
        return torch.where(self._count > 0, spread, 1.0)

    @property
    def terms(self) -> tuple[Tensor, Tensor]:
        """What is taken off each column, and what it is multiplied by then: float32, (columns,) each."""
        return self._shift, self._scale

    def update(self, rows: Tensor) -> None:
        """Take rows (n, columns) into the statistics."""
        self._count += rows.shape[0]
        deviation = rows.double().sub_(self.mean)  # from the mean so far: sums of squares then cancel nothing
        sums = deviation.sum(0)
        change = sums / self._count
        self._squares.add_(deviation.square_().sum(0)).addcmul_(sums, change, value=-1)
        self.mean.add_(change)
        self._refresh()

    def _refresh(self) -> None:
        self._shift.copy_(self.mean)
        self._scale.copy_(self.spread.reciprocal_())

    def __call__(self, rows: Tensor) -> Tensor:
        """(n, columns) normalised and clipped; a new tensor."""
        return (rows - self._shift).mul_(self._scale).clamp_(-self.clip, self.clip)

    def inverse(self, rows: Tensor) -> Tensor:
        """What `__call__` was given, where it clipped nothing."""
        return rows / self._scale + self._shift

    def state(self) -> State:
        return {"count": self.count, "mean": self.mean.clone(), "squares": self._squares.clone()}

    def load_state(self, state: State) -> None:
        self._count.fill_(int(state["count"]))
        self.mean.copy_(torch.as_tensor(state["mean"]))
        self._squares.copy_(torch.as_tensor(state["squares"]))
        self._refresh()
