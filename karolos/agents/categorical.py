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

    def backward(self, head: Tensor, action: Tensor, for_log_probability: Tensor, for_entropy: float) -> Tensor:
        """The gradient of the network's output (n, count).

        With p = softmax(head) and entropy H: d log p_a / d head_j = (j = a) - p_j, d H / d head_j = -p_j (log p_j + H).

        Args:
            head: the network's output.
            action: indices, (n, 1).
            for_log_probability: the loss's gradient by each action's log probability, (n,).
            for_entropy: the same by each entropy.
        """
        log_probability, pull = torch.log_softmax(head, -1), for_log_probability.unsqueeze(-1)
        probability = log_probability.exp()
        entropy = -(probability * log_probability).sum(-1, keepdim=True)
        found = (log_probability + entropy).mul_(-for_entropy).sub_(pull).mul_(probability)
        return found.scatter_add_(-1, action.long(), pull)

    def state(self) -> State:
        """Nothing: all that is learned is the network's."""
        return {}

    def load_state(self, state: State) -> None:
        pass
