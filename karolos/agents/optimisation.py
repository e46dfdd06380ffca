"""Adam (Kingma, Ba 2015) over parameter vectors, with a state of plain tensors; how long its steps are, and why."""

from __future__ import annotations

from typing import Any

import torch
from pydantic import Field as Setting
from pydantic import model_validator
from torch import Tensor

from ..core import AgentSettings, State
from ..core.schedules import Linear


class OptimiserSettings(AgentSettings):
    """Settings of every agent that makes one step of Adam per update."""

    learning_rate: float = Setting(1e-3, gt=0, description="of all networks (Adam)")
    learning_rate_end: float | None = Setting(
        None, ge=0, description="where the learning rate goes evenly over learning_rate_updates; null: it stays"
    )
    learning_rate_updates: int | None = Setting(None, ge=1, description="updates after which it is there")
    gradient_norm: float | None = Setting(None, gt=0, description="longer gradients are cut to this; null: never")

    @model_validator(mode="after")
    def _schedule_is_whole(self) -> Any:
        if (self.learning_rate_end is None) != (self.learning_rate_updates is None):
            raise ValueError("learning_rate_end and learning_rate_updates go together: give both or neither")
        return self

    @property
    def rate(self) -> Linear:
        """The learning rate after so many steps of an optimiser."""
        if self.learning_rate_end is None:
            return Linear(self.learning_rate, self.learning_rate, 0)
        return Linear(self.learning_rate, self.learning_rate_end, self.learning_rate_updates or 0)


class Adam:
    """Steps one parameter vector.

    Args:
        vector: the parameters, changed in place.
        learning_rate: size of a step; may be set anew before each. A schedule goes by the steps taken.
        epsilon: keeps steps small where gradients have been about this size.
        norm: longer gradients are cut to this length; None: never.
    """

    def __init__(
        self, vector: Tensor, learning_rate: float | Linear, *, epsilon: float = 1e-8, norm: float | None = None
    ) -> None:
        self._vector = vector
        self._schedule = learning_rate if isinstance(learning_rate, Linear) else None
        rate = learning_rate.start if isinstance(learning_rate, Linear) else learning_rate
        self.learning_rate = rate
        self._epsilon = epsilon
        self.norm = norm
        self.steps = 0
        """Taken so far."""
        # Where updates may be captured; on a CPU a number is quicker.
        self._rate = None if vector.device.type == "cpu" else torch.full((), rate, device=vector.device)
        self._state = {
            "step": torch.zeros((), device=vector.device),
            "exp_avg": torch.zeros_like(vector),
            "exp_avg_sq": torch.zeros_like(vector),
        }

    def step(self, gradient: Tensor) -> Tensor:
        """Step along a gradient of the vector's shape, which may be changed in place. Returns its length before."""
        self.begin()
        return self.move(gradient, "length", watch=True)["length"]

    def begin(self) -> None:
        """Count a step and set its learning rate; then `move`. Apart because Python counts and a captured update
        cannot.
        """
        if self._schedule is not None:
            self.learning_rate = self._schedule(self.steps)
        if self._rate is not None:
            self._rate.fill_(self.learning_rate)
        self.steps += 1

    def move(self, gradient: Tensor, name: str = "", *, watch: bool = False) -> dict[str, Tensor]:
        """Step along a gradient of the vector's shape, which may be changed in place.

        Returns its length before it was cut, under that name, if somebody watches: measuring it takes a third of the
        step.
        """
        measured = {}
        if watch or self.norm is not None:
            length = torch.linalg.vector_norm(gradient)
            measured = {name: length} if watch else {}
            if self.norm is not None:
                gradient.mul_((self.norm / length).clamp_(max=1))
        self._fused_step(gradient)
        torch.autograd.graph.increment_version(self._vector)  # which a fused step forgets; networks look at it
        return measured

    def rate_watched(self, *, watch: bool) -> dict[str, Tensor]:
        """The learning rate of the latest step, if somebody watches."""
        return {"learning_rate": torch.tensor(self.learning_rate)} if watch else {}

    def _fused_step(self, gradient: Tensor) -> None:
        """What torch.optim.Adam(fused=True) calls in the end; its own way there takes longer than the step itself."""
        self._state["step"].add_(1)
        torch._fused_adam_(
            [self._vector],
            [gradient],
            [self._state["exp_avg"]],
            [self._state["exp_avg_sq"]],
            [],
            [self._state["step"]],
            lr=self.learning_rate if self._rate is None else self._rate,
            beta1=0.9,
            beta2=0.999,
            weight_decay=0.0,
            eps=self._epsilon,
            amsgrad=False,
            maximize=False,
        )

    def state(self) -> State:
        return {name: value.clone() for name, value in self._state.items()}

    def load_state(self, state: State) -> None:
        for name, value in self._state.items():
            value.copy_(torch.as_tensor(state[name]))
        self.steps = int(self._state["step"])
