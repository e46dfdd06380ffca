"""Gradients that agents write down, against those that autograd finds for the losses as their papers give them."""

from typing import Any

import numpy as np
import pytest
import torch
from support.parts import batch, leaf, make, plain, signature, suited
from torch import Tensor
from torch.nn.functional import mse_loss, smooth_l1_loss

from karolos.agents.actor_critic import imitation_loss
from karolos.agents.ddpg import DDPG
from karolos.agents.dqn import DQN
from karolos.agents.inputs import TensorBatch, tensor_batch
from karolos.agents.networks import MLP
from karolos.agents.ppo import PPO, Gaussian, RolloutBatch
from karolos.agents.sac import SAC
from karolos.agents.td3 import TD3
from karolos.core import Batch

OPTIONS: list[dict[str, Any]] = [
    {},
    {"layer_norm": True},
    {"action_penalty": 20.0},
    {"imitation": 2.0},
    {"imitation": 2.0, "cloning": True},
    {"imitation": 2.0, "action_penalty": 20.0, "layer_norm": True},
]
NOT_OBSERVED = 1001
"""An update whose batch does not enter the statistics of inputs."""
STILL = {"hidden": (32, 24), "precision": "float32", "learning_rate": 1e-12}


def data(critic_only: int = 0) -> Batch:
    weight = np.linspace(0.5, 1.5, 64).astype(np.float32)
    shown = (np.arange(64) % 3 == 0).astype(np.float32)
    return batch(64, signature(critic_only=critic_only), discount=0.5)._replace(weight=weight, demonstrated=shown)


def value(critic: MLP, inputs: TensorBatch, action: Tensor) -> Tensor:
    """(members, n, quantiles)."""
    return plain(critic, torch.cat((inputs.critic_input, action), 1))


def critics_gradient(critic: MLP, inputs: TensorBatch, targets: Tensor) -> Tensor:
    """Of the weighted mean squared error, summed over the critics."""
    parameters = leaf(critic)
    values = plain(critic, torch.cat((inputs.critic_input, inputs.action), 1), parameters).squeeze(-1)
    error = (inputs.weight * (values - targets.squeeze(1)).square()).sum()
    return torch.autograd.grad(error, parameters)[0]


def shown(action: Tensor, better: Tensor, inputs: TensorBatch, *, cloning: bool) -> Tensor:
    """Mean squared distance to the demonstrated actions that the critics prefer, or to all."""
    assert inputs.demonstrated is not None
    assert 0 < (inputs.demonstrated * better).sum() < inputs.demonstrated.sum()
    distance = (action - inputs.action).square().sum(1)
    return (inputs.demonstrated * (better | cloning) * distance).sum() / inputs.demonstrated.sum()


@pytest.mark.parametrize("critic_only", [0, 4])
@pytest.mark.parametrize("options", [*OPTIONS, {"critic": {}}, {"critic": {"quantiles": 5}, "imitation": 2.0}])
def test_sacs_gradients_are_those_of_its_losses(options, critic_only):
    agent = make(SAC, signature(critic_only=critic_only), temperature=0.3, **STILL, **options)
    settings = agent.settings
    before = agent.generator.get_state()
    agent.learn(data(critic_only))
    found = {"policy": agent.policy.gradient.clone(), "critic": agent.critic.gradient.clone()}

    inputs = tensor_batch(data(critic_only), agent.normaliser, agent.device, NOT_OBSERVED, critic_only)
    noise = torch.randn((128, 2), generator=agent.generator.set_state(before))

    def policys(values: Tensor) -> Tensor:
        return values.mean((0, 2)) if settings.critic else values.squeeze(-1).min(0).values

    policy = leaf(agent.policy)
    mean, log_std = plain(agent.policy, inputs.input, policy).chunk(2, -1)
    gaussian = torch.distributions.Normal(mean, log_std.exp())
    unbounded = mean + log_std.exp() * noise[64:]
    action = torch.tanh(unbounded)
    log_probability = (gaussian.log_prob(unbounded) - torch.log(1 - action.square())).sum(1)
    loss = (inputs.weight * (0.3 * log_probability - policys(value(agent.critic, inputs, action)))).sum()
    loss = loss * (not settings.cloning)  # the critics' values are ignored
    loss = loss + settings.action_penalty * action.square().mean()
    middle = torch.tanh(mean)
    better = policys(value(agent.critic, inputs, inputs.action)) > policys(value(agent.critic, inputs, middle))
    loss = loss + settings.imitation * shown(middle, better, inputs, cloning=settings.cloning)
    expected = torch.autograd.grad(loss, policy)[0]
    torch.testing.assert_close(found["policy"], expected, rtol=1e-3, atol=1e-6)
    if settings.critic is None:
        agent.generator.set_state(before)
        targets = agent.targets(inputs, agent.draw(inputs.both_inputs).action[:64])
        expected = critics_gradient(agent.critic, inputs, targets)
        torch.testing.assert_close(found["critic"], expected, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("agent", [DDPG, TD3])
@pytest.mark.parametrize("options", OPTIONS)
def test_deterministic_agents_gradients_are_those_of_their_losses(agent, options):
    more = {"policy_delay": 1, "target_noise": 0.0} if agent is TD3 else {}
    made = make(agent, **STILL, **more, **options)
    settings = made.settings
    made.learn(data())
    found = {"policy": made.policy.gradient.clone(), "critic": made.critic.gradient.clone()}

    inputs = tensor_batch(data(), made.normaliser, made.device, update=NOT_OBSERVED)
    policy = leaf(made.policy)
    action = torch.tanh(plain(made.policy, inputs.input, policy))
    own, demonstrated = (value(made.critic, inputs, a)[0, :, 0] for a in (action, inputs.action))
    loss = (-inputs.weight * own).sum() * (not settings.cloning) + settings.action_penalty * action.square().mean()
    loss = loss + settings.imitation * shown(action, demonstrated > own, inputs, cloning=settings.cloning)
    expected = torch.autograd.grad(loss, policy)[0]
    torch.testing.assert_close(found["policy"], expected, rtol=1e-3, atol=1e-6)
    expected = critics_gradient(made.critic, inputs, made.targets(inputs, made.next_action(inputs.next_input)))
    torch.testing.assert_close(found["critic"], expected, rtol=1e-3, atol=1e-6)


def test_without_demonstrations_nothing_is_imitated():
    for agent in (SAC, DDPG, TD3):
        made = make(agent, imitation=1.0, **STILL)
        assert "imitation_loss" not in made.learn(batch(64, signature()))
        none = tensor_batch(data()._replace(demonstrated=np.zeros(64, np.float32)), made.normaliser, made.device)
        assert imitation_loss(torch.ones(64, 2), torch.ones(64, dtype=torch.bool), none)[0].item() == 0


@pytest.mark.parametrize("dueling", [False, True])
@pytest.mark.parametrize("options", [{}, {"loss": "squared"}, {"layer_norm": True}, {"double_q": False}])
def test_dqns_gradient_is_that_of_its_loss(options, dueling):
    of, weight = suited(DQN), np.linspace(0.5, 1.5, 64)
    reward = np.linspace(-3, 3, 64)  # errors on both sides of huber's corners
    played = batch(64, of, discount=0.5, weight=weight, reward=reward)
    agent = make(DQN, dueling=dueling, **STILL, **options)
    settings = agent.settings
    told = agent.learn(played)
    found = agent.network.gradient.clone()

    inputs = tensor_batch(played, agent.normaliser, agent.device, update=NOT_OBSERVED)
    network = leaf(agent.network)
    head = plain(agent.network, inputs.input, network)
    values = head[:, :1] + head[:, 1:] - head[:, 1:].mean(1, keepdim=True) if dueling else head
    targets = agent.targets(inputs)
    mine = values.gather(1, inputs.action.long()).squeeze(1)
    loss_of = smooth_l1_loss if settings.loss == "huber" else mse_loss
    loss = (inputs.weight * loss_of(mine, targets, reduction="none")).sum()
    torch.testing.assert_close(told["value_loss"], loss.detach())
    torch.testing.assert_close(told["priorities"], (mine - targets).abs().detach())
    torch.testing.assert_close(found, torch.autograd.grad(loss, network)[0], rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("options", [{}, {"entropy": 0.3}, {"value_clip": 0.1, "clip": 0.05}])
@pytest.mark.parametrize("discrete", [False, True])
def test_ppos_gradients_are_those_of_its_losses(discrete, options):
    chosen = {"hidden": (32, 24), "learning_rate": 1e-12, "gradient_norm": None, **options}
    agent = make(PPO, signature(labels=3 * discrete), **chosen)
    settings = agent.settings
    generator = torch.Generator().manual_seed(1)

    def noise(*size: int) -> Tensor:
        return torch.randn(size, generator=generator)

    inputs = noise(64, 5)
    agent.policy.vector.add_(noise(len(agent.policy.vector)), alpha=0.1)  # away from even odds and zero means
    log_std = torch.tensor([-0.5, 0.3])
    if isinstance(agent.distribution, Gaussian):
        agent.distribution.log_std.copy_(log_std)
    action = torch.randint(3, (64, 1), generator=generator).float() if discrete else noise(64, 2)
    taken = RolloutBatch(
        inputs=inputs,
        action=action,
        log_probability=agent.distribution.log_probability(agent.policy(inputs), action) + 0.3 * noise(64),
        advantage=noise(64),
        value=agent.value(inputs) + 0.1 * noise(64),
        target=noise(64),
    )
    policy, value = leaf(agent.policy), leaf(agent.value.network)
    log_std.requires_grad_()
    told = agent.update(taken)
    assert told is not None

    head = plain(agent.policy, inputs, policy)
    if discrete:
        odds: Any = torch.distributions.Categorical(logits=head)
        log_probability, entropy = odds.log_prob(action[:, 0]), odds.entropy()
    else:
        odds = torch.distributions.Normal(head, log_std.exp())
        log_probability, entropy = odds.log_prob(action).sum(1), odds.entropy().sum(1)
    ratio = torch.exp(log_probability - taken.log_probability)
    better = (taken.advantage - taken.advantage.mean()) / taken.advantage.std(correction=0)
    gain = torch.minimum(ratio * better, ratio.clamp(1 - settings.clip, 1 + settings.clip) * better).mean()
    loss = -gain - settings.entropy * entropy.mean()
    torch.testing.assert_close(told["policy_loss"], -gain.detach())
    torch.testing.assert_close(told["entropy"], entropy.mean().detach())
    assert (told["clip_fraction"] > 0.05).item(), "some rows are clipped"
    expected = torch.autograd.grad(loss, [policy] if discrete else [policy, log_std])
    torch.testing.assert_close(agent.policy.gradient, expected[0], rtol=1e-3, atol=1e-6)
    if isinstance(agent.distribution, Gaussian):
        torch.testing.assert_close(agent.distribution.gradient, expected[1], rtol=1e-3, atol=1e-6)

    values = plain(agent.value.network, inputs, value).squeeze(-1)  # before any return the scale is 1
    error = (values - taken.target).square()
    if settings.value_clip is not None:
        near = taken.value + (values - taken.value).clamp(-settings.value_clip, settings.value_clip)
        assert (near != values).any()
        error = torch.maximum(error, (near - taken.target).square())
    torch.testing.assert_close(told["value_loss"], 0.5 * error.mean().detach())
    expected = torch.autograd.grad(0.5 * error.mean(), value)
    torch.testing.assert_close(agent.value.network.gradient, expected[0], rtol=1e-3, atol=1e-6)
