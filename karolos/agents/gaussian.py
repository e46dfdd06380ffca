"""The policy of PPO over continuous actions: a Gaussian with a spread of its own for each action column."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..core import State

LOG_STD = (-5.0, 2.0)
"""Where the log of the spread is kept: below, probabilities explode; above, clipping leaves only corners."""


class Gaussian:
    """Actions around the network's output, with a spread that does not depend on what is observed.

    Nothing bounds a sample: environments get it clipped to [-1, 1], and probabilities are those of the unclipped one.
    Clipped or squashed samples would have to be turned back first, which is impossible at the edges.

    Args:
        columns: of an action.
        std: spread at the start.
        device: where the spread lives.
    """

    def __init__(self, columns: int, std: float, device: str) -> None:
        self.columns = columns
        """Outputs that the policy network needs."""
        self.log_std = torch.full((columns,), math.log(std), device=device)
        """The learned parameters, (a,). Change it in place."""
        self.gradient = torch.zeros_like(self.log_std)
        """What the latest `backward` found."""

    def sample(self, head: Tensor, generator: torch.Generator) -> Tensor:
        """Unclipped actions (n, a) from the network's output (n, a)."""
        noise = torch.randn(head.shape, generator=generator, device=head.device)
        return torch.addcmul(head, self.log_std.exp(), noise)

    def mode(self, head: Tensor) -> Tensor:
        """The action without noise, (n, a) in [-1, 1]."""
        return head.clamp(-1, 1)

    def log_probability(self, head: Tensor, action: Tensor) -> Tensor:
        """Log density of unclipped actions, (n,)."""
        distance = (action - head) * torch.exp(-self.log_std)
        constant = 0.5 * math.log(2 * math.pi) * self.columns
        return -(distance.square().mul(0.5) + self.log_std).sum(-1) - constant

    def entropy(self, head: Tensor) -> Tensor:
        """In nats, of the unclipped action: (n,)."""
        each = self.log_std.sum() + 0.5 * self.columns * (1 + math.log(2 * math.pi))
        return each.expand(len(head))

    def backward(self, head: Tensor, action: Tensor, for_log_probability: Tensor, for_entropy: float) -> Tensor:
        """The gradient of the network's output (n, a); that of the spread is left in `gradient`.

        With d = (action - head) / std: d log p / d head = d / std, d log p / d log std = d^2 - 1, and the entropy grows
        by 1 with each log std.

        Args:
            head: the network's output.
            action: unclipped, (n, a).
            for_log_probability: the loss's gradient by each action's log density, (n,).
            for_entropy: the same by each entropy.
        """
        inverse, pull = torch.exp(-self.log_std), for_log_probability.unsqueeze(-1)
        distance = (action - head) * inverse
        torch.sum((distance.square() - 1).mul_(pull), 0, out=self.gradient)
        self.gradient.add_(for_entropy * len(head))
        return distance.mul_(pull).mul_(inverse)

    def keep_bounds(self) -> None:
        """To be called after each step of the optimiser."""
        self.log_std.clamp_(*LOG_STD)

    def state(self) -> State:
        return {"log_std": self.log_std.clone()}

    def load_state(self, state: State) -> None:
        self.log_std.copy_(torch.as_tensor(state["log_std"]))
