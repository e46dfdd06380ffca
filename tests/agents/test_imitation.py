"""The imitation term: demonstrated actions are copied where the critics think better of them, and nowhere else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from support.parts import batch, signature

from karolos.agents.actor_critic import imitation_loss
from karolos.agents.ddpg import DDPG
from karolos.agents.inputs import tensor_batch
from karolos.agents.sac import SAC
from karolos.agents.td3 import TD3
from karolos.core import Agent, Batch
from karolos.core.seeding import SeedTree

AGENTS = [SAC, DDPG, TD3]


def make(agent: type[Agent], **settings: Any) -> Any:
    fixed = {"hidden": (32, 32), "precision": "float32", "learning_rate": 3e-3}
    delay = {"policy_delay": 1} if agent is TD3 else {}
    return agent(agent.Settings.model_validate({**fixed, **delay, **settings}), signature(), SeedTree(0))


def demonstrated(share: float, seed: int = 0, size: int = 64) -> Batch:
    flags = (np.arange(size) < share * size).astype(np.float32)
    return batch(size, signature(), seed)._replace(demonstrated=flags)


def prefer(agent: Any, *, shown: bool) -> None:
    """Make the critics like large actions (what is shown is 1, the policy gives about 0), or dislike them."""
    critic = agent.critic
    critic.vector.zero_()
    named = critic.named
    for column in (5, 6):  # behind 3 columns of observation and 2 of goal
        named["layer0.weight"][:, 0, column] = 1
    named["layer1.weight"][:, 0, 0] = 1
    named["layer2.weight"][:, 0, 0] = 1 if shown else -1
    named["layer0.bias"][:, 0, 0] = 5


@pytest.mark.parametrize("agent", AGENTS)
def test_the_term_is_zero_where_the_critic_prefers_the_policys_own_action(agent: type[Agent]) -> None:
    for shown in (True, False):
        made = make(agent, imitation=1.0, learning_rate=1e-9)
        prefer(made, shown=shown)
        metrics = made.learn(demonstrated(0.5)._replace(action=np.ones((64, 2), np.float32)))
        assert (metrics["imitation_loss"] > 0.1).item() is shown


def test_the_term_is_the_mean_over_demonstrated_rows_alone() -> None:
    agent = make(SAC)
    data = demonstrated(0.5, size=4)
    inputs = tensor_batch(data, agent.normaliser, agent.device)
    action = torch.zeros(4, 2)
    found, slope = imitation_loss(action, torch.tensor([True, False, True, True]), inputs)
    assert found.item() == pytest.approx((data.action[0] ** 2).sum() / 2)
    torch.testing.assert_close(slope, torch.cat((-inputs.action[:1], torch.zeros(3, 2))))  # 2 (0 - a) / 2
    none = tensor_batch(demonstrated(0.0, size=4), agent.normaliser, agent.device)
    assert imitation_loss(action, torch.ones(4, dtype=torch.bool), none)[0].item() == 0


@pytest.mark.parametrize("agent", AGENTS)
def test_without_demonstrations_in_the_buffer_there_is_no_term(agent: type[Agent]) -> None:
    metrics = make(agent, imitation=1.0).learn(batch(16, signature()))
    assert "imitation_loss" not in metrics


@pytest.mark.parametrize("agent", AGENTS)
@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_imitation_draws_the_policy_to_what_is_shown(agent: type[Agent], weight: float) -> None:
    made = make(agent, imitation=weight, discount=0.0)
    prefer(made, shown=True)
    made.critic.named["layer0.bias"][:, 0, 0] = -1  # flat where the policy acts: no way uphill
    made.policy.vector.mul_(0.1)
    if agent is SAC:
        made.policy.named["layer2.bias"][:, 2:] = -9  # clamped: its spread stays as small as it may be
    for seed in range(60):
        shown = demonstrated(1.0, seed % 10)._replace(action=np.ones((64, 2), np.float32))
        made.learn(shown._replace(reward=np.ones(64, np.float32), terminated=np.ones(64, np.float32)))
    data = batch(50, signature(), 99)
    actions = made.act(data.observation, data.desired_goal, explore=False)
    assert bool(actions.mean() > 0.7) is bool(weight)


@pytest.mark.parametrize("agent", AGENTS)
def test_cloning_imitates_what_the_critics_dislike_too(agent: type[Agent]) -> None:
    made = make(agent, imitation=1.0, cloning=True)
    prefer(made, shown=False)
    for seed in range(60):
        made.learn(demonstrated(1.0, seed % 10)._replace(action=np.ones((64, 2), np.float32)))
    data = batch(50, signature(), 99)
    assert made.act(data.observation, data.desired_goal, explore=False).mean() > 0.7
