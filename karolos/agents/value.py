"""The value of observations, learned in units of the returns' own spread."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core import State
from .networks import MLP, Shape
from .normaliser import Normaliser
from .orthogonal import make_orthogonal


class Value:
    """A network whose output, times the spread of the returns plus their mean, is the value of what it is shown.

    Returns of -1000 are then learned as fast as returns of 1. When mean and spread change, the last layer changes with
    them, so that all values stay as they were (PopArt, van Hasselt et al. 2016).

    Args:
        sizes: columns in, hidden units of each layer.
        generator: draws the weights.
        device: where everything lives.
    """

    def __init__(self, sizes: tuple[int, ...], generator: torch.Generator, device: str) -> None:
        self.network = MLP(Shape((*sizes, 1)), generator, device)
        make_orthogonal(self.network, generator, last_gain=1.0)
        self._returns = Normaliser(1, device)

    def _scale(self) -> tuple[Tensor, Tensor]:
        """Mean and spread of the returns so far: float32, (1,) each."""
        return self._returns.mean.float(), self._returns.spread.float()

    def __call__(self, inputs: Tensor) -> Tensor:
        """Values (n,) of normalised observations (n, i)."""
        mean, spread = self._scale()
        return torch.addcmul(mean, self.network(inputs).squeeze(-1), spread)

    def fit_scale(self, returns: Tensor) -> None:
        """Take returns (n,) into mean and spread; values stay as they are."""
        mean, spread = self._scale()
        self._returns.update(returns.unsqueeze(1))
        new_mean, new_spread = self._scale()
        last = len(self.network.shape.sizes) - 2
        weight, bias = (self.network.named[f"layer{last}.{part}"] for part in ("weight", "bias"))
        weight.mul_(spread / new_spread)
        bias.mul_(spread).add_(mean - new_mean).div_(new_spread)

    def learn(self, inputs: Tensor, target: Tensor, before: Tensor, clip: float | None) -> Tensor:
        """Half the mean squared error, in spreads of the returns; its gradient is left in the network's.

        Args:
            inputs: normalised observations (n, i).
            target: what their values should be, (n,).
            before: their values when the rollout was played, (n,).
            clip: how far in spreads a value may move from `before` and gain by it; None: any way.
        """
        mean, spread = self._scale()
        target = (target - mean) / spread
        head, tapes = self.network.forward(inputs)
        value = head.squeeze(-1)
        slope = value - target
        error = slope.square()
        if clip is not None:
            before = (before - mean) / spread
            near = before + (value - before).clamp(-clip, clip)
            clipped = (near - target).square()
            slope = slope * (error >= clipped)  # the clipped error is the larger one only where it does not move
            error = torch.maximum(error, clipped)
        self.network.backward((slope / len(slope)).unsqueeze(-1), tapes)
        return 0.5 * error.mean()

    def state(self) -> State:
        return {"network": self.network.state(), "returns": self._returns.state()}

    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of a network of another shape."""
        self.network.load_state(state["network"])
        self._returns.load_state(state["returns"])
