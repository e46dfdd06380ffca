"""The policy of SAC: a Gaussian whose samples tanh squashes into [-1, 1] (Haarnoja et al. 2018, appendix C)."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

LOG_STD = (-5.0, 2.0)
"""Where the log of the spread is clamped: below, log-probabilities explode; above, tanh leaves only corners."""


class Sample(NamedTuple):
    """Actions in [-1, 1], and what leads to them: (n, a) each. With s the clamped log spread, m the mean, e the noise:
    action = tanh(u), u = m + exp(s) e."""

    action: Tensor
    unbounded: Tensor
    """u"""
    shift: Tensor
    """exp(s) e"""
    log_std: Tensor
    """s"""
    within: Tensor
    """Whether s is the network's own, not clamped."""
    noise: Tensor
    """e"""

    def rows(self, first: int) -> Sample:
        """The same without the rows before `first`."""
        return Sample(*(field[first:] for field in self))


def mode(head: Tensor) -> Tensor:
    """The action without noise, (n, a), from the network's output (n, 2 a): mean and log spread."""
    return torch.tanh(head.chunk(2, -1)[0])


def sample(head: Tensor, noise: Tensor) -> Sample:
    """Actions from the network's output (n, 2 a) and standard normal noise (n, a)."""
    mean, raw = head.chunk(2, -1)
    log_std = raw.clamp(*LOG_STD)
    shift = log_std.exp() * noise
    unbounded = mean + shift
    return Sample(torch.tanh(unbounded), unbounded, shift, log_std, raw == log_std, noise)


def log_probability(drawn: Sample) -> Tensor:
    """Log densities of the actions, (n,).

    log(1 - tanh(u)^2) is written 2 (log 2 - u - softplus(-2 u)), which stays finite for any u.
    """
    gaussian = torch.addcmul(drawn.log_std, drawn.noise, drawn.noise, value=0.5)
    soft = functional.softplus(drawn.unbounded, beta=-2)  # - softplus(-2 u) / 2
    correction = torch.sub(drawn.unbounded, soft, alpha=2)
    constant = drawn.action.shape[-1] * (0.5 * math.log(2 * math.pi) + 2 * math.log(2))
    return -constant - gaussian.sub_(correction, alpha=2).sum(-1)


def head_gradient(drawn: Sample, for_action: Tensor, for_log_probability: Tensor) -> Tensor:
    """The gradient of the network's output (n, 2 a) from those of actions (n, a) and log-probabilities (n,).

    d tanh(u) / du = 1 - tanh(u)^2, d log p / du = 2 tanh(u), d log p / ds = -1 at fixed u, du / ds = exp(s) e.
    """
    pull = for_log_probability.unsqueeze(-1)
    for_mean = torch.ops.aten.tanh_backward(for_action, drawn.action).addcmul_(pull, drawn.action, value=2)
    for_log_std = (for_mean * drawn.shift).sub_(pull).mul_(drawn.within)
    return torch.cat((for_mean, for_log_std), -1)
