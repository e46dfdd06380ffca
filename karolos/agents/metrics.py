"""What agents tell about their updates: named scalars, computed in some updates only."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from .optimisation import Adam

REPORT_EVERY = 8
"""One update in this many computes its metrics, which takes 2 % of an update."""

Metrics = dict[str, Tensor | Callable[[], Tensor]]
"""Named scalars, most of them not computed yet."""


def report(metrics: Metrics, optimisers: Mapping[str, Adam], turn: int) -> dict[str, Any]:
    """Priorities, and in one turn of `REPORT_EVERY` the computed metrics and the learning rates."""
    if turn % REPORT_EVERY:
        return {"priorities": metrics["priorities"]}
    computed = {name: value() if callable(value) else value for name, value in metrics.items()}
    return computed | learning_rates(optimisers)


def learning_rates(optimisers: Mapping[str, Adam]) -> dict[str, Tensor]:
    """The learning rate of each optimiser, as metrics."""
    return {f"{name}_learning_rate": torch.tensor(optimiser.learning_rate) for name, optimiser in optimisers.items()}


def saturation(action: Tensor) -> Tensor:
    """Fraction of the action's numbers beyond +- 0.99."""
    return (action.abs() > 0.99).float().mean()
