"""Adam (Kingma, Ba 2015) over parameter vectors, with a state of plain tensors."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core import State


class Adam:
    """Steps one parameter vector along its `grad`.

    Args:
        vector: what is stepped; its gradient lies in `vector.grad`.
        learning_rate: size of a step.
    """

    def __init__(self, vector: Tensor, learning_rate: float) -> None:
        self._vector = vector
        self._optimiser = torch.optim.Adam([vector], lr=learning_rate, fused=True)

    def step(self) -> None:
        self._optimiser.step()

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
