"""Critics that give quantiles of the return: TQC (Kuznetsov et al. 2020, arXiv 2005.04269)."""

from __future__ import annotations

import torch
from pydantic import Field as Setting
from pydantic import model_validator
from torch import Tensor

from ..core import Settings as BaseSettings
from .actor_critic import Critic


class Quantiles(BaseSettings):
    """Truncated quantile critics. Defaults: of the paper (25 atoms; 2 to drop on most of its tasks)."""

    quantiles: int = Setting(25, ge=2, le=1000, description="quantiles of the return per critic")
    drop: int = Setting(2, ge=0, description="largest quantiles per critic left out of targets, against overestimation")

    @model_validator(mode="after")
    def _some_stay(self) -> Quantiles:
        if self.drop >= self.quantiles:
            raise ValueError(f"drop {self.drop} leaves nothing of {self.quantiles} quantiles")
        return self


class QuantileCritic(Critic):
    """Each network gives quantiles of the return. Targets leave the `drop` x members largest out."""

    def __init__(self, settings: Quantiles) -> None:
        self.columns = settings.quantiles
        self._drop = settings.drop

    def target_values(self, outputs: Tensor) -> Tensor:
        """The quantiles of all critics together, (n, k), ascending."""
        members, _, quantiles = outputs.shape
        pooled = outputs.movedim(0, 1).flatten(1)
        return pooled.sort(dim=1).values[:, : members * (quantiles - self._drop)]

    def loss(self, outputs: Tensor, targets: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
        """sum over members and rows of weight mean_jk |tau_j - 1{u < 0}| huber(u), and its gradient by the quantiles.

        u = y_k - theta_j, tau_j = (2 j + 1) / 2 q, huber(u) = u^2 / 2 where |u| <= 1, else |u| - 1/2. Source: Dabney
        et al. 2018, equation 10, kappa = 1. Both come from cumulative sums over the ascending targets; the members x n
        x q x k differences take twice as long, most of it for fresh memory.
        """
        members, rows, quantiles = outputs.shape
        tau = ((torch.arange(quantiles, device=outputs.device) + 0.5) / quantiles).repeat(members)
        weight = (weight / (quantiles * targets.shape[1])).unsqueeze(1)
        centre = targets.mean(1, keepdim=True)  # sums of squares about the mean lose the fewest digits
        flat = outputs.movedim(0, 1).flatten(1)
        below, above = _huber_sums((targets - centre).double(), (flat - centre).double())
        loss = (weight * ((1 - tau) * below[0] + tau * above[0])).sum()
        gradient = weight * ((1 - tau) * below[1] + tau * above[1])
        return loss.to(outputs.dtype), gradient.view(rows, members, quantiles).movedim(1, 0).to(outputs.dtype)

    def mean(self, outputs: Tensor) -> Tensor:
        return outputs.mean(-1)

    def policy_value(self, outputs: Tensor) -> Tensor:
        return outputs.mean((0, 2))

    def policy_value_gradient(self, outputs: Tensor, value: Tensor, gradient: Tensor) -> Tensor:  # noqa: ARG002
        return (gradient / (outputs.shape[0] * outputs.shape[2])).view(1, -1, 1).expand_as(outputs)


def _huber_sums(targets: Tensor, values: Tensor) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Sums of huber(target - value), and their derivatives by the value, over the targets below and above each value.

    Args:
        targets: (n, k), ascending.
        values: (n, v).

    Returns:
        (sum, derivative) below, and (sum, derivative) above: (n, v) each.
    """
    powers = torch.stack((targets, targets.square())).cumsum(2)
    sums = torch.nn.functional.pad(powers, (1, 0))  # of the first 0 .. k targets, and of their squares
    places = [torch.searchsorted(targets, values + distance) for distance in (-1, 0, 1)]
    low, middle, high = ([sums[power].gather(1, place) for power in (0, 1)] for place in places)
    counts = [place.to(values.dtype) for place in places]  # targets below value - 1, value, value + 1
    far_above = targets.shape[1] - counts[2]

    def squared(first: list[Tensor], last: list[Tensor], number: Tensor) -> tuple[Tensor, Tensor]:
        """Half the squared distances of the targets between two places, and the sum of their distances."""
        one, two = last[0] - first[0], last[1] - first[1]
        return (two - 2 * values * one + number * values.square()) / 2, one - number * values

    squared_below, distance_below = squared(low, middle, counts[1] - counts[0])
    squared_above, distance_above = squared(middle, high, counts[2] - counts[1])
    linear_below = counts[0] * (values - 0.5) - low[0]
    linear_above = sums[0][:, -1:] - high[0] - far_above * (values + 0.5)
    below = (squared_below + linear_below, counts[0] - distance_below)
    return below, (squared_above + linear_above, -distance_above - far_above)
