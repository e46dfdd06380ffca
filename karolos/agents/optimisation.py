"""Adam (Kingma, Ba 2015) over parameter vectors, and the settings of its steps."""

from __future__ import annotations

from typing import Annotated, Any

import torch
from pydantic import Field as Setting
from pydantic import model_validator
from torch import Tensor

from ..core import AgentSettings, State
from ..core.schedules import Linear

Hidden = Annotated[tuple[Annotated[int, Setting(ge=1, le=65_536)], ...], Setting(min_length=1, max_length=32)]
"""Units of each hidden layer."""


class OptimiserSettings(AgentSettings):
    """Settings of every agent that optimises with Adam."""

    learning_rate: float = Setting(1e-3, gt=0, description="of all networks (Adam)")
    learning_rate_end: float | None = Setting(
        None, ge=0, description="learning rate after learning_rate_updates, reached linearly; null: constant"
    )
    learning_rate_updates: int | None = Setting(
        None, ge=1, description="updates of the agent until learning_rate_end is reached, whatever its policy_delay"
    )
    gradient_norm: float | None = Setting(None, gt=0, description="longer gradients are clipped to this; null: never")

    @model_validator(mode="after")
    def _schedule_is_whole(self) -> Any:
        if (self.learning_rate_end is None) != (self.learning_rate_updates is None):
            raise ValueError("learning_rate_end and learning_rate_updates go together: give both or neither")
        return self

    @property
    def rate(self) -> Linear:
        """The learning rate by the number of the agent's updates."""
        if self.learning_rate_end is None:
            return Linear(self.learning_rate, self.learning_rate, 0)
        return Linear(self.learning_rate, self.learning_rate_end, self.learning_rate_updates or 0)


class Adam:
    """Optimises one parameter vector; its state is plain tensors.

    Args:
        vector: the parameters, changed in place.
        learning_rate: of the next step; it may be set before each.
        epsilon: added to the root of the second moment.
        norm: longer gradients are clipped to this length; None: never.
    """

    def __init__(
        self, vector: Tensor, learning_rate: float, *, epsilon: float = 1e-8, norm: float | None = None
    ) -> None:
        self._vector, self.learning_rate, self._epsilon, self._norm = vector, learning_rate, epsilon, norm
        self._gradient = vector
        self._length: Tensor | None = None
        self.steps = 0
        """Made so far."""
        self._state = {
            "step": torch.zeros((), device=vector.device),
            "exp_avg": torch.zeros_like(vector),
            "exp_avg_sq": torch.zeros_like(vector),
        }

    def step(self, gradient: Tensor) -> None:
        """Make a step with the gradient, of the vector's shape. A gradient that is too long is shortened in place."""
        self.steps += 1
        self._gradient = gradient
        if self._norm is not None:
            self._length = torch.linalg.vector_norm(gradient)
            gradient.mul_((self._norm / self._length).clamp_(max=1))
        self._state["step"].add_(1)
        # The kernel of torch.optim.Adam(fused=True), whose Python takes longer than the kernel itself.
        torch._fused_adam_(
            [self._vector],
            [gradient],
            [self._state["exp_avg"]],
            [self._state["exp_avg_sq"]],
            [],
            [self._state["step"]],
            lr=self.learning_rate,
            beta1=0.9,
            beta2=0.999,
            weight_decay=0.0,
            eps=self._epsilon,
            amsgrad=False,
            maximize=False,
        )
        # The fused step does not count as a change of the vector, and networks look at its version.
        torch.autograd.graph.increment_version(self._vector)

    def gradient_norm(self) -> Tensor:
        """The length of the latest step's gradient before clipping. Measuring it takes a third of the step."""
        return torch.linalg.vector_norm(self._gradient) if self._length is None else self._length

    def state(self) -> State:
        return {name: value.clone() for name, value in self._state.items()}

    def load_state(self, state: State) -> None:
        for name, value in self._state.items():
            value.copy_(torch.as_tensor(state[name]))
        self.steps = int(self._state["step"])
