"""What the values of agents that replay mean, whatever the algorithm."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from support import parts
from support.parts import batch, signature

from karolos.agents.ddpg import DDPG
from karolos.agents.dqn import DQN
from karolos.agents.inputs import TensorBatch, tensor_batch
from karolos.agents.sac import SAC
from karolos.agents.td3 import TD3
from karolos.core import Batch, Discrete, Signature
from karolos.errors import UsageError

ACTIONS = Discrete(("left", "right", "wait", "jump"))
KINDS: list[tuple[Any, dict[str, Any]]] = [
    (SAC, {}),
    (SAC, {"critic": {"quantiles": 5, "drop": 0}}),
    (DDPG, {}),
    (TD3, {}),
    (DQN, {}),
    (DQN, {"dueling": True}),
    (DQN, {"loss": "squared", "layer_norm": True}),
]


def make(kind: Any, of: Signature | None = None, **settings: Any) -> Any:
    of = of or signature()
    return parts.make(kind, replace(of, action=ACTIONS) if kind is DQN else of, **settings)


def played(kind: Any, size: int, seed: int = 0, **fixed: Any) -> Batch:
    if kind is not DQN:
        return batch(size, signature(), seed, **fixed)
    action = np.random.default_rng(seed).integers(len(ACTIONS.labels), size=(size, 1))
    return batch(size, replace(signature(), action=ACTIONS), seed, **{"action": action, **fixed})


def values(agent: Any, data: TensorBatch) -> torch.Tensor:
    if isinstance(agent, DQN):
        output = agent.network(data.input)
        return output[:, 0] if agent.settings.dueling else output  # of the state: the mean over the actions
    outputs: torch.Tensor = agent.critic(torch.cat((data.input, data.action), 1))
    return outputs


def targets(agent: Any, data: TensorBatch) -> torch.Tensor:
    if isinstance(agent, DQN):
        return agent.targets(data)
    action = agent.draw(data.next_input).action if isinstance(agent, SAC) else agent.next_action(data.next_input)
    found: torch.Tensor = agent.targets(data, action)
    return found


@pytest.mark.parametrize(("kind", "settings"), KINDS)
@pytest.mark.parametrize(("terminated", "value"), [(0.0, 5.0), (1.0, 1.0)])
def test_values_look_beyond_a_truncation_and_not_beyond_a_termination(kind, settings, terminated, value):
    agent = make(kind, discount=0.8, learning_rate=6e-3, **settings)
    for seed in range(350):
        agent.learn(played(kind, 32, seed % 20, reward=1, terminated=terminated, discount=0.8))
    data = tensor_batch(played(kind, 200, 99), agent.normaliser, agent.device)
    assert values(agent, data).mean().item() == pytest.approx(value, rel=0.06)


@pytest.mark.parametrize(("kind", "settings"), KINDS)
def test_targets_stay_within_what_rewards_make_possible(kind, settings):
    bounded = replace(signature(), reward_range=(-1.0, 0.0))
    for clip in (True, False):
        agent = make(kind, bounded, discount=0.9, clip_targets=clip, **settings)
        for reward, possible in ((-100, -10), (100, 0)):
            data = played(kind, 64, reward=reward, terminated=1)
            found = targets(agent, tensor_batch(data, agent.normaliser, agent.device))
            np.testing.assert_allclose(found, possible if clip else reward, rtol=1e-6)


@pytest.mark.parametrize("kind", [SAC, DDPG, TD3])
def test_discrete_actions_are_refused(kind):
    with pytest.raises(UsageError, match="continuous actions"):
        make(kind, replace(signature(), action=ACTIONS))
