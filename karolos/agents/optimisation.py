"""Adam (Kingma, Ba 2015) over parameter vectors, and the settings of its steps."""

from __future__ import annotations

from collections.abc import Mapping
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
        learning_rate: a constant, or a schedule by the agent's updates.
        epsilon: added to the root of the second moment.
        norm: longer gradients are clipped to this length; None: never.
    """

    def __init__(
        self, vector: Tensor, learning_rate: float | Linear, *, epsilon: float = 1e-8, norm: float | None = None
    ) -> None:
        self._vector = vector
        self._schedule = learning_rate if isinstance(learning_rate, Linear) else None
        self.learning_rate = learning_rate.start if isinstance(learning_rate, Linear) else learning_rate
        self._epsilon = epsilon
        self.norm = norm
        self.steps = 0
        """Made so far."""
        self._state = {
            "step": torch.zeros((), device=vector.device),
            "exp_avg": torch.zeros_like(vector),
            "exp_avg_sq": torch.zeros_like(vector),
        }

    def step(
        self, gradient: Tensor, name: str = "", *, update: int | None = None, report: bool = False
    ) -> dict[str, Tensor]:
        """Make a step.

        Args:
            gradient: of the vector's shape; it may be changed in place.
            name: of the gradient's length in the result.
            update: updates that the agent has made before this one, for the schedule of the learning rate; None: the
                steps made, where every update makes one.
            report: return the gradient's length before clipping. Measuring it takes a third of the step.
        """
        if self._schedule is not None:
            self.learning_rate = self._schedule(self.steps if update is None else update)
        self.steps += 1
        metrics = {}
        if report or self.norm is not None:
            length = torch.linalg.vector_norm(gradient)
            metrics = {name: length} if report else {}
            if self.norm is not None:
                gradient.mul_((self.norm / length).clamp_(max=1))
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
        return metrics

    def state(self) -> State:
        return {name: value.clone() for name, value in self._state.items()}

    def load_state(self, state: State) -> None:
        for name, value in self._state.items():
            value.copy_(torch.as_tensor(state[name]))
        self.steps = int(self._state["step"])


def learning_rates(optimisers: Mapping[str, Adam]) -> dict[str, Tensor]:
    """The learning rate of each optimiser's latest step, as metrics."""
    return {f"{name}_learning_rate": torch.tensor(optimiser.learning_rate) for name, optimiser in optimisers.items()}
