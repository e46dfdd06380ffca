"""DDPG and TD3: what their values mean, what tells them apart, how they explore."""

from typing import Any

import numpy as np
import pytest
import torch
from support.parts import batch, make, signature

from karolos.agents.ddpg import DDPG
from karolos.agents.inputs import TensorBatch, tensor_batch
from karolos.agents.td3 import TD3

AGENTS = [DDPG, TD3]


def targets_of(agent: Any, inputs: TensorBatch) -> torch.Tensor:
    targets: torch.Tensor = agent.targets(inputs, agent.next_action(inputs.next_input))
    return targets


def test_the_smaller_of_td3s_critics_counts():
    made = make(TD3, target_noise=0.0)
    inputs = tensor_batch(batch(32, signature(), reward=0, discount=1), made.normaliser, made.device)
    action = torch.tanh(made.target_policy(inputs.next_input))
    both = made.target(torch.cat((inputs.next_input, action), 1)).squeeze(-1)
    assert (both[0] != both[1]).all()
    torch.testing.assert_close(targets_of(made, inputs), both.amin(0).unsqueeze(1))


def test_td3_smooths_its_targets_over_actions_nearby_and_ddpg_does_not():
    for agent, draws in ((TD3, True), (DDPG, False)):
        made = make(agent)
        inputs = tensor_batch(batch(32, signature()), made.normaliser, made.device)
        assert torch.equal(targets_of(made, inputs), targets_of(made, inputs)) is not draws


@pytest.mark.parametrize(("agent", "every"), [(DDPG, 1), (TD3, 2)])
def test_policy_and_targets_move_when_it_is_their_turn(agent, every):
    made = make(agent)
    for update in range(1, 7):
        before = {name: getattr(made, name).vector.clone() for name in ("policy", "target", "target_policy")}
        made.learn(batch(32, signature(), update))
        moved = {name: not torch.equal(getattr(made, name).vector, old) for name, old in before.items()}
        assert set(moved.values()) == {update % every == 0}


@pytest.mark.parametrize("agent", AGENTS)
def test_exploration_is_noise_around_the_policy_and_a_share_of_uniform_actions(agent):
    made = make(agent, noise={"std": 0.05}, random_actions=0.25)
    data = batch(4000, signature())
    plain = made.act(data.observation, data.desired_goal, explore=False)
    noisy = made.act(data.observation, data.desired_goal, explore=True)
    near = (np.abs(noisy - plain) < 0.2).all(1)  # four standard deviations
    inside = np.minimum(plain + 0.2, 1) - np.maximum(plain - 0.2, -1)
    by_chance = (inside / 2).prod(1).mean()
    assert near.mean() == pytest.approx(0.75 + 0.25 * by_chance, abs=0.03)
    assert np.abs(noisy).max() <= 1
