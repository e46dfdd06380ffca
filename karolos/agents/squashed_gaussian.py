"""The policy of SAC: a Gaussian whose samples tanh squashes into [-1, 1] (Haarnoja et al. 2018, appendix C)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from .layers import Tape

LOG_STD_BOUNDS = (-5.0, 2.0)
"""Bounds of a policy's log standard deviation: below, log probabilities explode; above, actions are corners only."""


class SquashedActions(NamedTuple):
    """Actions in [-1, 1] and the terms they are computed from, (n, a) each.

    action = tanh(u), u = m + exp(s) e, with the mean m, the clamped log standard deviation s and the noise e.
    """

    action: Tensor
    unbounded: Tensor
    """u"""
    shift: Tensor
    """exp(s) e"""
    log_std: Tensor
    """s"""
    unclamped: Tensor
    """Whether s is the network's output itself."""
    noise: Tensor
    """e"""
    tapes: tuple[Tape, ...] = ()
    """The tapes of the policy network's pass."""

    def split(self, count: int) -> tuple[SquashedActions, SquashedActions]:
        """The first `count` rows without tapes, and the other rows with tapes."""
        *fields, tapes = self
        first = [*(field[:count] for field in fields), ()]
        others = [*(field[count:] for field in fields), tuple(tape.rows(count) for tape in tapes)]
        return SquashedActions._make(first), SquashedActions._make(others)

    def mode(self) -> Tensor:
        """tanh(m)"""
        return torch.tanh(self.unbounded - self.shift)

    def log_probability(self) -> Tensor:
        """Log densities of the actions, (n,).

        log(1 - tanh(u)^2) is computed as 2 (log 2 - u - softplus(-2 u)), which is finite for any u.
        """
        gaussian = torch.addcmul(self.log_std, self.noise, self.noise, value=0.5)
        soft = functional.softplus(self.unbounded, beta=-2)  # - softplus(-2 u) / 2
        correction = torch.sub(self.unbounded, soft, alpha=2)
        constant = self.action.shape[-1] * (0.5 * math.log(2 * math.pi) + 2 * math.log(2))
        return -constant - gaussian.sub_(correction, alpha=2).sum(-1)

    def backward(self, by_action: Tensor, by_log_probability: Tensor) -> Tensor:
        """The gradient by the network's output (n, 2 a) from those by actions (n, a) and log probabilities (n,).

        d tanh(u) / du = 1 - tanh(u)^2, d log p / du = 2 tanh(u), d log p / ds = -1 at fixed u, du / ds = exp(s) e.
        """
        column = by_log_probability.unsqueeze(-1)
        by_mean = torch.ops.aten.tanh_backward(by_action, self.action).addcmul_(column, self.action, value=2)
        by_log_std = (by_mean * self.shift).sub_(column).mul_(self.unclamped)
        return torch.cat((by_mean, by_log_std), -1)


def squashed(output: Tensor, noise: Tensor, tapes: Iterable[Tape] = ()) -> SquashedActions:
    """Actions from the network's output (n, 2 a), mean and log standard deviation, and standard normal noise (n, a)."""
    mean, raw = output.chunk(2, -1)
    log_std = raw.clamp(*LOG_STD_BOUNDS)
    shift = log_std.exp() * noise
    unbounded = mean + shift
    return SquashedActions(torch.tanh(unbounded), unbounded, shift, log_std, raw == log_std, noise, tuple(tapes))
