"""What agents with a policy of continuous actions and critics of them share."""

from __future__ import annotations

from typing import Any

import torch
from pydantic import Field as Setting
from torch import Tensor

from ..core import State
from .device import PRECISION_MEANS, Precision
from .inputs import Inputs
from .optimisation import OptimiserSettings


class ActorCriticSettings(OptimiserSettings):
    """Settings of every such agent."""

    discount: float = Setting(0.95, ge=0, lt=1, description="per environment step; about 1 - 1 / steps of episode")
    hidden: tuple[int, ...] = Setting((256, 256), min_length=1, description="units of each hidden layer")
    tau: float = Setting(0.05, gt=0, le=1, description="share of the networks that their targets take per update")
    layer_norm: bool = Setting(False, description="layer-normalised critics: steadier, a little slower")
    clip_targets: bool = Setting(True, description="cut targets to what the declared reward range makes possible")
    action_penalty: float = Setting(0.0, ge=0, description="weight of the mean squared action in the policy's loss")
    imitation: float = Setting(
        0.0, ge=0, description="weight of the squared distance to demonstrated actions that the critics think better of"
    )
    precision: Precision = Setting("auto", description=PRECISION_MEANS)


WATCHED_EVERY = 8
"""One update of so many says how it went. What there is to say takes twenty small operations, 2 % of an update."""


def squared_loss(values: Tensor, targets: Tensor, share: Tensor) -> tuple[Tensor, Tensor]:
    """The sum over the critics of their mean squared errors, and its gradient.

    Args:
        values: what each critic says, (members, n, 1).
        targets: what they should say, (n,).
        share: of each row in the mean, (n,).
    """
    errors = values.squeeze(-1) - targets
    slope = errors * share
    return torch.dot(slope.view(-1), errors.view(-1)), slope.mul_(2).unsqueeze(-1)


def imitation_loss(action: Tensor, better: Tensor, inputs: Inputs) -> tuple[Tensor, Tensor]:
    """Mean over the demonstrated rows of |pi(s) - a|^2 where the demonstrated action is better; 0 without such rows.

    And its gradient by pi(s). Source: Nair et al. 2018, "Overcoming Exploration in Reinforcement Learning with
    Demonstrations", equations 3 and 5.

    Args:
        action: pi(s), (n, a).
        better: Q(s, a) > Q(s, pi(s)), (n,).
        inputs: the batch.
    """
    assert inputs.demonstrated is not None
    apart = action - inputs.action
    share = inputs.demonstrated * better / inputs.demonstrated.sum().clamp(min=1)
    return torch.dot(share, apart.square().sum(1)), 2 * share.unsqueeze(1) * apart


def critic_metrics(loss: Tensor, values: Tensor, targets: Tensor, *, watch: bool) -> dict[str, Any]:
    """How wrong critics were about each transition; and what there is to watch of an update, if somebody does.

    Args:
        loss: a scalar.
        values: what each critic said, (members, n).
        targets: what they should have said, (n,).
        watch: False: priorities alone.
    """
    priorities = (values - targets).abs_().amax(0)
    if not watch:
        return {"priorities": priorities}
    return {
        "critic_loss": loss,
        "value_mean": values.mean(),
        "value_max": values.max(),
        "target_mean": targets.mean(),
        "priorities": priorities,
    }


def parts_state(agent: Any, names: tuple[str, ...]) -> State:
    """The states of an agent's attributes of these names, of its optimisers and of its generator."""
    return {
        **{name: getattr(agent, name).state() for name in names},
        "optimisers": {name: optimiser.state() for name, optimiser in agent.optimisers.items()},
        "generator": agent.generator.get_state(),
    }


def load_parts(agent: Any, names: tuple[str, ...], state: State) -> None:
    """Put back what `parts_state` found. Raises UsageError when a state is of a network of another shape."""
    for name in names:
        getattr(agent, name).load_state(state[name])
    for name, optimiser in agent.optimisers.items():
        optimiser.load_state(state["optimisers"][name])
    agent.generator.set_state(torch.as_tensor(state["generator"]))
