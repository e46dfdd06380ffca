"""The policy of SAC: a Gaussian whose samples tanh squashes into [-1, 1] (Haarnoja et al. 2018, appendix C)."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

LOG_STD = (-5.0, 2.0)
"""Bounds of the log standard deviation: below, log probabilities explode; above, tanh gives corners only."""


class Sample(NamedTuple):
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

    def rows(self, first: int) -> Sample:
        """The rows from `first` on."""
        return Sample(*(field[first:] for field in self))


def sample(output: Tensor, noise: Tensor) -> Sample:
    """Actions from the network's output (n, 2 a), mean and log standard deviation, and standard normal noise (n, a)."""
    mean, raw = output.chunk(2, -1)
    log_std = raw.clamp(*LOG_STD)
    shift = log_std.exp() * noise
    unbounded = mean + shift
    return Sample(torch.tanh(unbounded), unbounded, shift, log_std, raw == log_std, noise)


def log_probability(drawn: Sample) -> Tensor:
    """Log densities of the actions, (n,).

    log(1 - tanh(u)^2) is computed as 2 (log 2 - u - softplus(-2 u)), which is finite for any u.
    """
    gaussian = torch.addcmul(drawn.log_std, drawn.noise, drawn.noise, value=0.5)
    soft = functional.softplus(drawn.unbounded, beta=-2)  # - softplus(-2 u) / 2
    correction = torch.sub(drawn.unbounded, soft, alpha=2)
    constant = drawn.action.shape[-1] * (0.5 * math.log(2 * math.pi) + 2 * math.log(2))
    return -constant - gaussian.sub_(correction, alpha=2).sum(-1)


def output_gradient(drawn: Sample, action_gradient: Tensor, log_probability_gradient: Tensor) -> Tensor:
    """The gradient by the network's output (n, 2 a) from those by actions (n, a) and log probabilities (n,).

    d tanh(u) / du = 1 - tanh(u)^2, d log p / du = 2 tanh(u), d log p / ds = -1 at fixed u, du / ds = exp(s) e.
    """
    column = log_probability_gradient.unsqueeze(-1)
    by_mean = torch.ops.aten.tanh_backward(action_gradient, drawn.action).addcmul_(column, drawn.action, value=2)
    by_log_std = (by_mean * drawn.shift).sub_(column).mul_(drawn.unclamped)
    return torch.cat((by_mean, by_log_std), -1)
