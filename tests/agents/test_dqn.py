"""DQN: what its values mean, how it explores, and what it stores."""

from functools import partial

import numpy as np
import pytest
import torch
from support import parts
from support.parts import batch, suited

from karolos.agents.dqn import DQN
from karolos.agents.inputs import tensor_batch

OF = suited(DQN)
ACTIONS = 4
make = partial(parts.make, DQN)


@pytest.mark.parametrize("double_q", [True, False])
def test_target_is_what_the_target_network_says_of_the_action_that_the_online_network_prefers(double_q):
    agent = make(double_q=double_q, clip_targets=False)
    agent.target.vector.copy_(torch.randn(agent.target.vector.shape, generator=torch.Generator().manual_seed(3)))
    ended = (np.arange(64) % 3 == 0).astype(np.float32)
    data = batch(64, OF, terminated=ended, discount=0.9)
    inputs = tensor_batch(data, agent.normaliser, agent.device)
    online, theirs = (network(inputs.next_input).detach().numpy() for network in (agent.network, agent.target))
    preferred = (online if double_q else theirs).argmax(1)
    expected = data.reward + 0.9 * (1 - ended) * theirs[np.arange(64), preferred]
    np.testing.assert_allclose(agent.targets(inputs).numpy(), expected, rtol=1e-5)
    assert (online.argmax(1) != theirs.argmax(1)).any()


def test_long_gradients_are_cut_to_the_length_that_is_set():
    lengths, told = [], []
    for longest in (None, 0.5):
        agent = make(gradient_norm=longest, loss="squared")
        told.append(agent.learn(batch(32, OF, reward=50, terminated=1))["gradient_norm"].item())
        # Adam's first step leaves a tenth of the gradient in its running mean
        lengths.append(10 * np.linalg.norm(agent.state()["optimisers"]["network"]["exp_avg"]))
    assert lengths == pytest.approx([told[0], 0.5], rel=1e-4)
    assert told[0] == told[1] > 1


@pytest.mark.parametrize(("interval", "tau"), [(1, 0.1), (3, 1.0)])
def test_the_target_moves_when_it_is_its_turn_and_as_far_as_tau_says(interval, tau):
    agent = make(target_interval=interval, tau=tau)
    for update in range(1, 7):
        before = agent.target.vector.clone()
        agent.learn(batch(32, OF, update))
        expected = before.lerp(agent.network.vector, tau) if update % interval == 0 else before
        torch.testing.assert_close(agent.target.vector, expected)


def test_epsilon_falls_with_exploring_environment_steps_to_its_end_and_stays():
    agent = make(epsilon_start=0.9, epsilon_end=0.1, epsilon_steps=100)
    data = batch(10, OF)
    found = [agent.epsilon]
    for _ in range(12):
        agent.act(data.observation, data.desired_goal, explore=True)
        agent.act(data.observation, data.desired_goal, explore=False)  # a test: counts for nothing
        found.append(agent.epsilon)
    np.testing.assert_allclose(found[:11], np.linspace(0.9, 0.1, 11))
    assert found[11:] == [0.1, 0.1]
    assert agent.learn(data)["epsilon"].item() == pytest.approx(0.1)


def test_each_environment_explores_with_probability_epsilon_and_tests_do_not():
    agent = make(epsilon_start=0.4, epsilon_end=0.4)
    data = batch(4000, OF)
    best = agent.act(data.observation, data.desired_goal, explore=False)
    for _ in range(2):
        explored = agent.act(data.observation, data.desired_goal, explore=True)
        # a random action is the best one once in ACTIONS times
        assert (explored != best).mean() == pytest.approx(0.4 * (1 - 1 / ACTIONS), abs=0.03)
    greedy = make(epsilon_start=0.0, epsilon_end=0.0)
    np.testing.assert_array_equal(greedy.act(data.observation, data.desired_goal, explore=True), best)
