"""Normalises network inputs by running statistics."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core import State

CLIP = 5.0
"""Default bound of normalised inputs. Source: OpenAI baselines, HER (norm_clip)."""
SMALLEST_SPREAD = 0.01
"""Lower bound of a column's standard deviation. Source: OpenAI baselines, HER (norm_eps)."""


class Normaliser:
    """Running mean and standard deviation of columns (merged as in Chan et al. 1979).

    Only `update` changes the statistics; acting and tests leave them unchanged.

    Args:
        columns: how many.
        device: where the statistics live.
        clip: normalised columns are clipped to +- this.
    """

    def __init__(self, columns: int, device: str, *, clip: float = CLIP) -> None:
        self.clip = clip
        self.count = 0
        """Rows seen so far."""
        self.mean = torch.zeros(columns, dtype=torch.float64, device=device)
        self._squares = torch.zeros(columns, dtype=torch.float64, device=device)
        self._shift = torch.zeros(columns, device=device)
        self._scale = torch.ones(columns, device=device)

    @property
    def spread(self) -> Tensor:
        """Standard deviation of each column, at least SMALLEST_SPREAD; 1 before the first update."""
        if not self.count:
            return torch.ones_like(self._squares)
        return (self._squares / self.count).sqrt_().clamp_(min=SMALLEST_SPREAD)

    @property
    def terms(self) -> tuple[Tensor, Tensor]:
        """Shift and scale of `(x - shift) * scale`: float32, (columns,) each."""
        return self._shift, self._scale

    def update(self, rows: Tensor) -> None:
        """Add rows (n, columns) to the statistics."""
        self.count += rows.shape[0]
        deviation = rows.double().sub_(self.mean)  # from the current mean, so that the sums of squares stay exact
        sums = deviation.sum(0)
        change = sums / self.count
        self._squares.add_(deviation.square_().sum(0)).addcmul_(sums, change, value=-1)
        self.mean.add_(change)
        self._refresh()

    def _refresh(self) -> None:
        self._shift.copy_(self.mean)
        self._scale.copy_(self.spread.reciprocal_())

    def __call__(self, rows: Tensor) -> Tensor:
        """(n, columns) normalised and clipped; a new tensor."""
        return (rows - self._shift).mul_(self._scale).clamp_(-self.clip, self.clip)

    def state(self) -> State:
        return {"count": self.count, "mean": self.mean.clone(), "squares": self._squares.clone()}

    def load_state(self, state: State) -> None:
        self.count = int(state["count"])
        self.mean.copy_(torch.as_tensor(state["mean"]))
        self._squares.copy_(torch.as_tensor(state["squares"]))
        self._refresh()
