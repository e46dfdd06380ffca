"""Critics that give a distribution of returns, as quantiles: what TQC is made of (Kuznetsov et al. 2020)."""

from __future__ import annotations

import torch
from pydantic import Field as Setting
from pydantic import model_validator
from torch import Tensor

from ..core import Settings as BaseSettings


class Quantiles(BaseSettings):
    """Truncated quantile critics. Defaults: of the paper (25 atoms; 2 to drop on most of its tasks)."""

    quantiles: int = Setting(25, ge=2, description="of the return, that each critic gives")
    drop: int = Setting(2, ge=0, description="largest ones per critic that targets leave out: against overestimation")

    @model_validator(mode="after")
    def _some_stay(self) -> Quantiles:
        if self.drop >= self.quantiles:
            raise ValueError(f"drop {self.drop} leaves nothing of {self.quantiles} quantiles")
        return self


def truncated(values: Tensor, drop: int) -> Tensor:
    """Of the quantiles of all critics together, (members, n, q), all but the `drop` x members largest: (n, k)."""
    members, _, quantiles = values.shape
    pooled = values.movedim(0, 1).flatten(1)
    return pooled.sort(dim=1).values[:, : members * (quantiles - drop)]


def quantile_huber(values: Tensor, targets: Tensor, share: Tensor) -> tuple[Tensor, Tensor]:
    """How far quantiles (members, n, q) are from those of the returns, `targets` (n, k) ascending, and the gradient.

    The sum over members of the mean over n, q and k of |tau - 1{u < 0}| huber(u), u = target - value,
    tau = (2 j + 1) / 2 q (Dabney et al. 2018, equation 10, kappa = 1); in the mean over n each row has its `share`
    (n,). Loss and gradient come from running sums over the ascending targets: members x n x q x k differences take
    twice as long, most of it for fresh memory.
    """
    members, rows, quantiles = values.shape
    tau = ((torch.arange(quantiles, device=values.device) + 0.5) / quantiles).repeat(members)
    share = (share / (quantiles * targets.shape[1])).unsqueeze(1)
    middle = targets.mean(1, keepdim=True)  # about which sums of squares lose the fewest digits
    flat = values.movedim(0, 1).flatten(1)
    below, above = _sides((targets - middle).double(), (flat - middle).double())
    loss = (share * ((1 - tau) * below[0] + tau * above[0])).sum()
    slope = share * ((1 - tau) * below[1] + tau * above[1])
    return loss.to(values.dtype), slope.view(rows, members, quantiles).movedim(1, 0).to(values.dtype)


def _sides(targets: Tensor, values: Tensor) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Sums of huber(target - value), and their derivatives by the value, over the targets below and above each value.

    Args:
        targets: (n, k), ascending.
        values: (n, v).

    Returns:
        Four tensors (n, v).
    """
    count = targets.shape[1]
    powers = torch.stack((targets, targets.square())).cumsum(2)
    sums = torch.nn.functional.pad(powers, (1, 0))  # of the first 0 .. k targets, and of their squares
    places = [torch.searchsorted(targets, values + reach) for reach in (-1, 0, 1)]
    low, here, high = ([sums[power].gather(1, place) for power in (0, 1)] for place in places)
    near = [place.to(values.dtype) for place in places]
    below_near, above_near = near[1] - near[0], near[2] - near[1]
    above_far = count - near[2]

    def squares(first: list[Tensor], last: list[Tensor], number: Tensor) -> tuple[Tensor, Tensor]:
        """Half the squared distances of the targets between two places, and the distances."""
        one, two = last[0] - first[0], last[1] - first[1]
        return (two - 2 * values * one + number * values.square()) / 2, one - number * values

    half_below, off_below = squares(low, here, below_near)
    half_above, off_above = squares(here, high, above_near)
    line_below = near[0] * (values - 0.5) - low[0]
    line_above = sums[0][:, -1:] - high[0] - above_far * (values + 0.5)
    return (half_below + line_below, near[0] - off_below), (half_above + line_above, -off_above - above_far)
