"""Gradients that agents write down, against those that autograd finds for the losses as their papers give them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from parts import batch, signature
from torch import Tensor
from torch.nn.functional import mse_loss, smooth_l1_loss

from karolos.agents.ddpg import DDPG
from karolos.agents.dqn import DQN
from karolos.agents.inputs import Inputs, feed, normalised
from karolos.agents.sac import SAC
from karolos.agents.td3 import TD3
from karolos.core import Batch, Discrete
from karolos.seeding import SeedTree

OPTIONS: list[dict[str, Any]] = [
    {},
    {"layer_norm": True},
    {"action_penalty": 20.0},
    {"imitation": 2.0},
    {"imitation": 2.0, "action_penalty": 20.0, "layer_norm": True},
]
STILL = {"hidden": (32, 24), "precision": "float32", "learning_rate": 1e-12}


def data() -> Batch:
    weight = np.linspace(0.5, 1.5, 64).astype(np.float32)
    shown = (np.arange(64) % 3 == 0).astype(np.float32)
    return batch(64, signature(), discount=0.5)._replace(weight=weight, demonstrated=shown)


def value(critic: Any, inputs: Inputs, action: Tensor) -> Tensor:
    """(members, n, quantiles)."""
    found: Tensor = critic(torch.cat((inputs.here, action), 1))
    return found


def shown(action: Tensor, better: Tensor, inputs: Inputs) -> Tensor:
    """Mean squared distance to the demonstrated actions that the critics prefer."""
    assert inputs.demonstrated is not None
    distance = (action - inputs.action).square().sum(1)
    return (inputs.demonstrated * better * distance).sum() / inputs.demonstrated.sum()


@pytest.mark.parametrize("options", [*OPTIONS, {"critic": {}}, {"critic": {"quantiles": 5}, "imitation": 2.0}])
def test_sacs_gradients_are_those_of_its_losses(options: dict[str, Any]) -> None:
    settings = SAC.Settings.model_validate({**STILL, "temperature": 0.3, **options})
    agent = SAC(settings, signature(), SeedTree(0))
    before = agent.generator.get_state()
    agent.learn(data())
    found = {"policy": agent.policy.gradient.clone(), "critic": agent.critic.gradient.clone()}

    inputs = normalised(feed(data()), agent.normaliser, observe=False)
    noise = torch.randn((128, 2), generator=agent.generator.set_state(before))

    def policys(values: Tensor) -> Tensor:
        return values.mean((0, 2)) if settings.critic else values.squeeze(-1).min(0).values

    mean, log_std = agent.policy(inputs.here, learn=True).chunk(2, -1)
    gaussian = torch.distributions.Normal(mean, log_std.exp())
    unbounded = mean + log_std.exp() * noise[64:]
    action = torch.tanh(unbounded)
    log_probability = (gaussian.log_prob(unbounded) - torch.log(1 - action.square())).sum(1)
    loss = (inputs.weight * (0.3 * log_probability - policys(value(agent.critic, inputs, action)))).mean()
    loss = loss + settings.action_penalty * action.square().mean()
    middle = torch.tanh(mean)
    better = policys(value(agent.critic, inputs, inputs.action)) > policys(value(agent.critic, inputs, middle))
    loss = loss + settings.imitation * shown(middle, better, inputs)
    expected = torch.autograd.grad(loss, agent.policy.leaf)[0]
    torch.testing.assert_close(found["policy"], expected, rtol=1e-3, atol=1e-6)
    if settings.critic is None:
        agent.generator.set_state(before)
        with torch.no_grad():
            targets = agent.targets(inputs, agent._draw(inputs.observed)[0])
        values = agent.critic(torch.cat((inputs.here, inputs.action), 1), learn=True).squeeze(-1)
        error = (inputs.weight * (values - targets).square()).mean(1).sum()
        torch.testing.assert_close(
            found["critic"], torch.autograd.grad(error, agent.critic.leaf)[0], rtol=1e-3, atol=1e-6
        )


@pytest.mark.parametrize("agent", [DDPG, TD3])
@pytest.mark.parametrize("options", OPTIONS)
def test_deterministic_agents_gradients_are_those_of_their_losses(agent: Any, options: dict[str, Any]) -> None:
    more = {"policy_delay": 1, "target_noise": 0.0} if agent is TD3 else {}
    settings = agent.Settings.model_validate({**STILL, **more, **options})
    core = agent(settings, signature(), SeedTree(0)).core
    core.learn(data())
    found = {"policy": core.policy.gradient.clone(), "critic": core.critic.gradient.clone()}

    inputs = normalised(feed(data()), core.normaliser, observe=False)
    action = torch.tanh(core.policy(inputs.here, learn=True))
    own, demonstrated = (value(core.critic, inputs, a)[0, :, 0] for a in (action, inputs.action))
    loss = (-inputs.weight * own).mean() + settings.action_penalty * action.square().mean()
    loss = loss + settings.imitation * shown(action, demonstrated > own, inputs)
    expected = torch.autograd.grad(loss, core.policy.leaf)[0]
    torch.testing.assert_close(found["policy"], expected, rtol=1e-3, atol=1e-6)
    with torch.no_grad():
        targets = core.targets(inputs)
    values = core.critic(torch.cat((inputs.here, inputs.action), 1), learn=True).squeeze(-1)
    error = (inputs.weight * (values - targets).square()).mean(1).sum()
    expected = torch.autograd.grad(error, core.critic.leaf)[0]
    torch.testing.assert_close(found["critic"], expected, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("dueling", [False, True])
@pytest.mark.parametrize("options", [{}, {"loss": "squared"}, {"layer_norm": True}, {"double_q": False}])
def test_dqns_gradient_is_that_of_its_loss(options: dict[str, Any], dueling: bool) -> None:
    actions = 4
    of = replace(signature(), action=Discrete(tuple(map(str, range(actions)))))
    taken = np.random.default_rng(1).integers(actions, size=(64, 1))
    weight = np.linspace(0.5, 1.5, 64)
    reward = np.linspace(-3, 3, 64)  # errors on both sides of huber's corners
    played = batch(64, of, discount=0.5, action=taken, weight=weight, reward=reward)
    settings = DQN.Settings.model_validate({**STILL, "dueling": dueling, **options})
    agent = DQN(settings, of, SeedTree(0))
    told = agent.learn(played)
    found = agent.network.gradient.clone()

    inputs = normalised(feed(played), agent.normaliser, observe=False)
    head = agent.network(inputs.here, learn=True)
    values = head[:, :1] + head[:, 1:] - head[:, 1:].mean(1, keepdim=True) if dueling else head
    targets = agent.targets(inputs)
    mine = values.gather(1, inputs.action.long()).squeeze(1)
    loss_of = smooth_l1_loss if settings.loss == "huber" else mse_loss
    loss = (inputs.weight * loss_of(mine, targets, reduction="none")).mean()
    torch.testing.assert_close(told["value_loss"], loss.detach())
    torch.testing.assert_close(found, torch.autograd.grad(loss, agent.network.leaf)[0], rtol=1e-3, atol=1e-6)
