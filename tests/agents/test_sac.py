"""SAC: what its values mean, what it refuses, and that it goes on where it stopped."""

from functools import partial

import numpy as np
import pytest
import torch
from support import parts
from support.parts import batch, signature
from support.states import assert_same_state

from karolos.agents.inputs import ALL_OBSERVED, OBSERVED_EVERY, TensorBatch, tensor_batch
from karolos.agents.sac import SAC
from karolos.agents.squashed_gaussian import SquashedActions
from karolos.plugins.contracts import check

make = partial(parts.make, SAC)


def next_targets(agent: SAC, inputs: TensorBatch, drawn: SquashedActions) -> torch.Tensor:
    return agent.targets(inputs, drawn.action, agent.counted_entropy(drawn))


def test_the_target_counts_the_entropy_of_the_next_action_as_a_gain_only_when_asked():
    plain = make(clip_targets=False)
    soft = make(temperature=2.0, entropy_in_target=True, clip_targets=False)
    data = tensor_batch(batch(64, signature(), discount=0.5), plain.normaliser, plain.device)
    next_actions = soft.draw(data.next_input)
    difference = next_targets(soft, data, next_actions) - next_targets(plain, data, next_actions)
    head = soft.policy(data.next_input)
    gaussian = torch.distributions.Normal(head[:, :2], head[:, 2:].exp())
    action = next_actions.action.clamp(-1 + 1e-6, 1 - 1e-6)
    log_density = (gaussian.log_prob(action.atanh()) - torch.log(1 - action.square())).sum(1)
    torch.testing.assert_close(difference.squeeze(1), -0.5 * 2.0 * log_density, rtol=1e-3, atol=1e-3)


def test_transitions_that_weigh_nothing_teach_nothing():
    data = batch(32, signature())
    other = data._replace(reward=np.where(np.arange(32) < 16, data.reward, np.float32(50)))
    weight = (np.arange(32) < 16).astype(np.float32)
    states = []
    for each in (data, other):
        agent = make()
        agent.learn(each._replace(weight=weight))
        states.append(agent.critic.state())
    assert_same_state(*states)
    unweighted = make()
    unweighted.learn(other)
    assert not torch.equal(unweighted.critic.named["layer0.weight"], states[0]["layer0.weight"])


def test_a_policy_needs_nothing_of_what_critics_alone_observe():
    wide = signature(critic_only=4)
    agent = make(wide)
    for _ in range(3):
        agent.learn(batch(32, wide))
    data = batch(8, wide)
    acted = agent.act(data.observation, data.desired_goal, explore=False)
    np.testing.assert_array_equal(acted, agent.act(data.observation[:, :3], data.desired_goal, explore=False))
    other = make(wide)
    other.adopt(agent.deployed())
    assert agent.deployed().shift.size == 3 + 2
    np.testing.assert_allclose(acted, other.act(data.observation, data.desired_goal, explore=False), atol=1e-6)
    changed = data.observation.copy()
    changed[:, 3:] += 1
    agents = [make(wide), make(wide)]
    for one, observation in zip(agents, (data.observation, changed), strict=True):
        one.learn(data._replace(observation=observation))
    assert not torch.equal(*(one.critic.vector for one in agents))


@pytest.mark.parametrize("target", [0.3, -0.5])
def test_entropy_comes_near_its_target(target):
    of = signature(goal=0, action=1)
    agent = make(of, learning_rate=1e-2, target_entropy=target, temperature=0.2)
    entropies = []
    for seed in range(400):
        data = batch(64, of, seed, discount=0)
        metrics = agent.learn(data._replace(reward=-((data.action[:, 0] - 0.5) ** 2)))
        if "entropy" in metrics:
            entropies.append(float(metrics["entropy"]))
    assert np.mean(entropies[-12:]) == pytest.approx(target, abs=0.15)


def test_temperature_never_falls_below_its_minimum():
    agent = make(temperature=0.02, temperature_min=0.02, target_entropy=-50.0)
    for _ in range(5):
        agent.learn(batch(16, signature()))
    assert agent.log_temperature.exp().item() == pytest.approx(0.02)


def test_promises_of_agents_hold_in_bfloat16_with_an_average_policy():
    check("agents", "sac", layer_norm=True, precision="bfloat16", policy_average=0.1)


def test_a_state_of_a_gpu_goes_on_with_the_same_policy_and_other_random_numbers():
    first, second, third = make(), make(seed=7), make(seed=8)
    first.learn(batch(32, signature()))
    state = first.state() | {"generator": torch.arange(16, dtype=torch.uint8)}  # the size of a CUDA generator's state
    second.load_state(state)
    third.load_state(state)
    np.testing.assert_array_equal(first.act(*_seen(0), explore=False), second.act(*_seen(0), explore=False))
    np.testing.assert_array_equal(second.act(*_seen(0), explore=True), third.act(*_seen(0), explore=True))


def _seen(seed: int) -> tuple[np.ndarray, np.ndarray]:
    data = batch(5, signature(), seed)
    return data.observation, data.desired_goal


def test_batches_with_their_goals_enter_the_statistics_later_one_in_four_and_acting_does_not():
    agent, data = make(), batch(32, signature(), desired_goal=7)
    agent.learn(data)
    torch.testing.assert_close(agent.normaliser.mean[3:], torch.full((2,), 7.0, dtype=torch.float64))
    agent.act(*_seen(3), explore=True)
    agent.optimisers["critic"].steps = ALL_OBSERVED
    for _ in range(2 * OBSERVED_EVERY):
        agent.learn(data)
    assert agent.normaliser.count == 3 * 32


def test_the_share_of_random_actions_is_what_was_asked():
    agent = make(random_actions=0.25)
    agent.policy.named["layer2.bias"].copy_(torch.tensor([[30.0, 30, -9, -9]]))  # the policy itself gives 1 always
    data = batch(20_000, signature())
    actions = agent.act(data.observation, data.desired_goal, explore=True)
    assert (actions < 0.999).any(1).mean() == pytest.approx(0.25, abs=0.02)


def test_the_asked_share_of_environments_acts_without_noise():
    agent = make(quiet=0.4)
    environments = np.arange(20)
    acted = agent.act(*(np.repeat(part[:1], 20, 0) for part in _seen(0)), explore=True, environments=environments)
    (quiet,) = np.nonzero((acted == agent.act(*_seen(0), explore=False)[0]).all(1))
    assert len(quiet) == 8
    assert len(np.unique(acted, axis=0)) == 13


def test_the_average_policy_acts_in_tests_and_the_policy_itself_explores():
    agent = make(policy_average=0.25)
    expected = agent.policy.vector.clone()
    for seed in range(4):
        agent.learn(batch(16, signature(), seed))
        expected.lerp_(agent.policy.vector, 0.25)
    torch.testing.assert_close(agent.average.vector, expected)
    assert not torch.equal(agent.average.vector, agent.policy.vector)
    alike = make(seed=5)
    alike.start_from(agent.state())
    torch.testing.assert_close(alike.policy.vector, expected)
    acted = agent.act(*_seen(0), explore=False)
    np.testing.assert_array_equal(acted, alike.act(*_seen(0), explore=False))
    agent.average.vector.zero_()
    np.testing.assert_array_equal(agent.act(*_seen(0), explore=False), 0)
    assert np.abs(agent.act(*_seen(0), explore=True)).min() > 0


def test_a_run_that_starts_from_another_starts_its_average_there_too():
    source, agent = make(seed=3), make(policy_average=0.25)
    agent.start_from(source.state())
    np.testing.assert_array_equal(agent.act(*_seen(0), explore=False), source.act(*_seen(0), explore=False))
