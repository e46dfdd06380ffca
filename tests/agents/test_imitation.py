"""Behaviour cloning: demonstrated actions are copied, whatever the critics think of them."""

from typing import Any

import numpy as np
import pytest
from support.parts import batch, signature

from karolos.agents.ddpg import DDPG
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
def test_cloning_imitates_what_the_critics_dislike_too(agent: type[Agent]) -> None:
    made = make(agent, imitation=1.0, cloning=True)
    prefer(made, shown=False)
    for seed in range(60):
        made.learn(demonstrated(1.0, seed % 10)._replace(action=np.ones((64, 2), np.float32)))
    data = batch(50, signature(), 99)
    assert made.act(data.observation, data.desired_goal, explore=False).mean() > 0.7
