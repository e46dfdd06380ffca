"""The policy of SAC: a Gaussian whose samples tanh squashes into [-1, 1] (Haarnoja et al. 2018, appendix C)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

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


def sample(head: Tensor, noise: Tensor) -> Sample:
    """Actions from the network's output (n, 2 a) and standard normal noise (n, a), differentiable (reparametrised)."""
    if not torch.is_grad_enabled():
        return Sample(*_sample(head, noise)[:2])
    return Sample(*_Sample.apply(head, noise))  # type: ignore[no-untyped-call]


def _sample(head: Tensor, noise: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Actions, log-probabilities, the noise as it shifts the mean, and which spreads are not clamped."""
    mean, raw = head.chunk(2, -1)
    log_std = raw.clamp(*LOG_STD)
    shift = log_std.exp().mul_(noise)
    unbounded = mean + shift
    return torch.tanh(unbounded), log_probability(unbounded, log_std, noise), shift, raw == log_std


class _Sample(torch.autograd.Function):
    """`sample` as one node of the graph: autograd alone would make some thirty operations of a few numbers each.

    With s = clamp(log_std), u = mean + exp(s) noise: d tanh(u) / du = 1 - tanh(u)^2, d log p / du = 2 tanh(u),
    d log p / ds = -1 at fixed u, and du / ds = exp(s) noise.
    """

    @staticmethod
    def forward(ctx: Any, head: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        action, log_probability, shift, within = _sample(head, noise)
        ctx.save_for_backward(action, shift, within)
        return action, log_probability

    @staticmethod
    def backward(ctx: Any, for_action: Tensor, for_log_probability: Tensor) -> tuple[Tensor, None]:
        action, shift, within = ctx.saved_tensors
        pull = for_log_probability.unsqueeze(-1)
        for_mean = for_action * (1 - action.square()) + (2 * pull) * action
        for_log_std = torch.addcmul(-pull, for_mean, shift).mul_(within)
        return torch.cat((for_mean, for_log_std), -1), None


def log_probability(unbounded: Tensor, log_std: Tensor, noise: Tensor) -> Tensor:
    """Log density of tanh(unbounded), (n,), where unbounded = mean + exp(log_std) * noise.

    log(1 - tanh(u)^2) is written 2 (log 2 - u - softplus(-2 u)), which stays finite for any u.
    """
    gaussian = noise.square().mul(-0.5).sub(log_std)
    correction = unbounded + functional.softplus(-2 * unbounded)
    constant = unbounded.shape[-1] * (0.5 * math.log(2 * math.pi) + 2 * math.log(2))
    return torch.add(gaussian, correction, alpha=2).sum(-1) - constant
