"""Adam (Kingma, Ba 2015) over parameter vectors, and the metrics of updates, computed in some updates only."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from ..core import State

ADAM_REST: dict[str, Any] = {"beta1": 0.9, "beta2": 0.999, "weight_decay": 0.0, "amsgrad": False, "maximize": False}


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
        """Number of steps so far."""
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
        step, mean, square = self._state.values()
        step.add_(1)
        # The kernel of torch.optim.Adam(fused=True), whose Python takes longer than the kernel itself.
        rest = {**ADAM_REST, "lr": self.learning_rate, "eps": self._epsilon}
        torch._fused_adam_([self._vector], [gradient], [mean], [square], [], [step], **rest)
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


REPORT_EVERY = 8
"""Updates per computation of metrics, which takes 2 % of an update."""

Metrics = dict[str, Tensor | Callable[[], Tensor]]
"""Named scalars, most of them not computed yet; under `priorities` an array (n,)."""


def report(metrics: Metrics, optimisers: Mapping[str, Adam], turn: int) -> dict[str, Any]:
    """Priorities, and in every `REPORT_EVERY`-th update also the computed metrics and the learning rates."""
    if turn % REPORT_EVERY:
        return {"priorities": metrics["priorities"]}
    computed = {name: value() if callable(value) else value for name, value in metrics.items()}
    return computed | learning_rates(optimisers)


def learning_rates(optimisers: Mapping[str, Adam]) -> dict[str, Tensor]:
    """The learning rate of each optimiser, as metrics."""
    return {f"{name}_learning_rate": torch.tensor(optimiser.learning_rate) for name, optimiser in optimisers.items()}


def saturation(action: Tensor) -> Tensor:
    """Fraction of the action's numbers beyond +- 0.99."""
    return (action.abs() > 0.99).float().mean()
