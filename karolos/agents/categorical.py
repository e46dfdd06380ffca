"""The policy of PPO over a discrete set of actions."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core import State


class Categorical:
    """One of `count` actions, with probabilities that are the softmax of the network's output."""

    def __init__(self, count: int) -> None:
        self.columns = count
        """Outputs that the policy network needs."""

    def sample(self, head: Tensor, generator: torch.Generator) -> Tensor:
        """Indices (n, 1), as floats, from the network's output (n, count)."""
        return torch.multinomial(torch.softmax(head, -1), 1, generator=generator).float()

    def mode(self, head: Tensor) -> Tensor:
        """The likeliest index, (n, 1)."""
        return head.argmax(-1, keepdim=True).float()

    def log_probability(self, head: Tensor, action: Tensor) -> Tensor:
        """Of the indices (n, 1): (n,)."""
        return torch.log_softmax(head, -1).gather(-1, action.long()).squeeze(-1)

    def entropy(self, head: Tensor) -> Tensor:
        """In nats: (n,)."""
        log_probability = torch.log_softmax(head, -1)
        return -(log_probability.exp() * log_probability).sum(-1)

    def state(self) -> State:
        """Nothing: all that is learned is the network's."""
        return {}

    def load_state(self, state: State) -> None:
        pass
