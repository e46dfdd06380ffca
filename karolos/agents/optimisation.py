"""Adam (Kingma, Ba 2015) over parameter vectors, with a state of plain tensors."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core import State


class Adam:
    """Steps one parameter vector.

    Args:
        vector: a leaf of the graph.
        learning_rate: size of a step.
    """

    def __init__(self, vector: Tensor, learning_rate: float) -> None:
        self._vector = vector
        self._optimiser = torch.optim.Adam([vector], lr=learning_rate, fused=True)

    def step(self, loss: Tensor) -> None:
        """Lower the loss. Only this vector gets a gradient."""
        self.step_along(torch.autograd.grad(loss, self._vector)[0])

    def step_along(self, gradient: Tensor) -> None:
        """Step as if `gradient`, of the vector's shape, were a loss's."""
        self._vector.grad = gradient
        self._optimiser.step()
        torch.autograd.graph.increment_version(self._vector)  # which a fused step forgets; networks look at it

    def state(self) -> State:
        """Empty before the first step."""
        inner = self._optimiser.state.get(self._vector, {})
        return {name: value.clone() for name, value in inner.items()}

    def load_state(self, state: State) -> None:
        self._optimiser.state.pop(self._vector, None)
        if state:
            device = self._vector.device
            self._optimiser.state[self._vector] = {
                name: torch.as_tensor(value).clone().to(device) for name, value in state.items()
            }
