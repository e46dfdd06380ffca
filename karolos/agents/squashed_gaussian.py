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
    """Actions (n, a) in [-1, 1] and their log-probabilities (n,)."""

    action: Tensor
    log_probability: Tensor


def mode(head: Tensor) -> Tensor:
    """The action without noise, (n, a), from the network's output (n, 2 a): mean and log spread."""
    return torch.tanh(head.chunk(2, -1)[0])


def sample(head: Tensor, generator: torch.Generator) -> Sample:
    """Actions with noise from the network's output (n, 2 a), differentiable (reparametrised)."""
    mean, log_std = head.chunk(2, -1)
    log_std = log_std.clamp(*LOG_STD)
    noise = torch.randn(mean.shape, generator=generator, device=mean.device)
    unbounded = torch.addcmul(mean, log_std.exp(), noise)
    return Sample(torch.tanh(unbounded), log_probability(unbounded, log_std, noise))


def log_probability(unbounded: Tensor, log_std: Tensor, noise: Tensor) -> Tensor:
    """Log density of tanh(unbounded), (n,), where unbounded = mean + exp(log_std) * noise.

    log(1 - tanh(u)^2) is written 2 (log 2 - u - softplus(-2 u)), which stays finite for any u.
    """
    gaussian = noise.square().mul(-0.5).sub(log_std)
    correction = unbounded + functional.softplus(-2 * unbounded)
    constant = unbounded.shape[-1] * (0.5 * math.log(2 * math.pi) + 2 * math.log(2))
    return torch.add(gaussian, correction, alpha=2).sum(-1) - constant
