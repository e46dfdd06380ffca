"""What the values of agents that replay mean, whatever the algorithm, and what agents refuse."""

from typing import Any

import numpy as np
import pytest
import torch
from pydantic import ValidationError
from support.parts import batch, make, suited

from karolos.agents.ddpg import DDPG
from karolos.agents.dqn import DQN
from karolos.agents.inputs import TensorBatch, tensor_batch
from karolos.agents.noise import NoiseSettings
from karolos.agents.sac import SAC
from karolos.agents.td3 import TD3
from karolos.errors import UsageError

KINDS: list[tuple[Any, dict[str, Any]]] = [
    (SAC, {}),
    (SAC, {"critic": {"quantiles": 5, "drop": 0}}),
    (DDPG, {}),
    (TD3, {}),
    (DQN, {}),
    (DQN, {"dueling": True}),
    (DQN, {"loss": "squared", "layer_norm": True}),
]


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
        agent.learn(batch(32, suited(kind), seed % 20, reward=1, terminated=terminated, discount=0.8))
    data = tensor_batch(batch(200, suited(kind), 99), agent.normaliser, agent.device)
    assert values(agent, data).mean().item() == pytest.approx(value, rel=0.06)


@pytest.mark.parametrize(("kind", "settings"), KINDS)
@pytest.mark.parametrize(("rewards", "least", "most"), [((-1.0, 0.0), -10, 0), ((1.0, 2.0), 1, 20)])
def test_targets_stay_within_what_rewards_make_possible_also_of_an_episode_of_one_step(
    kind, settings, rewards, least, most
):
    bounded = suited(kind, reward_range=rewards)
    for clip in (True, False):
        agent = make(kind, bounded, discount=0.9, clip_targets=clip, **settings)
        for reward, possible in ((-100, least), (100, most)):
            data = batch(64, suited(kind), reward=reward, terminated=1)
            found = targets(agent, tensor_batch(data, agent.normaliser, agent.device))
            np.testing.assert_allclose(found, possible if clip else reward, rtol=1e-6)


@pytest.mark.parametrize(
    ("kind", "of", "reason"),
    [
        (SAC, suited(DQN), "continuous actions"),
        (DDPG, suited(DQN), "continuous actions"),
        (TD3, suited(DQN), "continuous actions"),
        (DQN, suited(SAC), r"2 continuous numbers.*environment\.actions=discrete"),
    ],
)
def test_actions_of_another_kind_are_refused_with_the_setting_that_helps(kind, of, reason):
    with pytest.raises(UsageError, match=reason):
        make(kind, of)


@pytest.mark.parametrize(
    ("settings", "given", "reason"),
    [
        (SAC.Settings, {"entropy_in_target": True}, "clip_targets: false"),
        (SAC.Settings, {"temperature": 0.01, "temperature_min": 0.02}, "below temperature_min"),
        (SAC.Settings, {"critic": {"quantiles": 3, "drop": 3}}, "leaves none"),
        (SAC.Settings, {"learning_rate_end": 1e-4}, "go together"),
        (SAC.Settings, {"per_joint": True, "hidden": (64,)}, "two numbers in hidden"),
        (DQN.Settings, {"epsilon_start": 0.1, "epsilon_end": 0.5}, r"epsilon_end 0\.5 is above epsilon_start 0\.1"),
        (NoiseSettings, {"theta": 0.1}, "theta goes with kind: ornstein_uhlenbeck"),
        (NoiseSettings, {"kind": "ornstein_uhlenbeck", "interval": 4}, "interval goes with kind: state_dependent"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(settings, given, reason):
    with pytest.raises(ValidationError, match=reason):
        settings.model_validate(given)
