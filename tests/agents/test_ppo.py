"""PPO: its advantages, the policy it compares with, what it learns, and what it forgets nothing of."""

from collections import Counter
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from support.parts import make, signature
from support.parts import rollout as rollout_of

from karolos.agents.ppo import PPO, Categorical, Gaussian, advantages
from karolos.core import Rollout

made = partial(make, PPO)


def written_out(rollout: Rollout, value: Any, next_value: Any, discount: float, decay: float) -> np.ndarray:
    """Advantages as the sum over all later steps of the same episode, environment by environment."""
    steps, n = rollout.reward.shape
    found = np.zeros((steps, n))
    for environment in range(n):
        for start in range(steps):
            for step in range(start, steps):
                if not rollout.stored[step, environment]:
                    break
                beyond = 0.0 if rollout.terminated[step, environment] else discount * next_value[step, environment]
                error = rollout.reward[step, environment] + beyond - value[step, environment]
                found[start, environment] += (discount * decay) ** (step - start) * error
                if rollout.ended[step, environment]:
                    break
    return found


@pytest.mark.parametrize("decay", [0.0, 0.7, 1.0])
def test_advantages_are_those_of_the_sum_written_out(decay):
    of, generator = signature(), np.random.default_rng(1)
    terminated, truncated = generator.random((8, 4)) < 0.2, generator.random((8, 4)) < 0.2
    stored = np.arange(8)[:, None] < [8, 5, 0, 8]
    ended = terminated | truncated | (np.arange(8)[:, None] == np.array([8, 5, 0, 8]) - 1)
    rollout = rollout_of(made(of), of, terminated=terminated, ended=ended, stored=stored)
    value, next_value = generator.normal(size=(2, 8, 4)).astype(np.float32)
    found = advantages(rollout, value, next_value, discount=0.9, trace_decay=decay)
    np.testing.assert_allclose(found, written_out(rollout, value, next_value, 0.9, decay), atol=1e-5)
    assert not found[~stored].any()


@pytest.mark.parametrize("kind", ["truncated", "terminated"])
def test_a_reward_of_one_is_worth_all_that_would_follow_a_truncated_step_and_one_before_a_terminated(kind):
    of = signature(goal=0)
    agent = made(of, discount=0.5, learning_rate=1e-2, epochs=10, minibatches=2)
    over = np.ones((8, 4), np.bool_)
    for number in range(20):
        here = np.random.default_rng(number).uniform(-1, 1, (8, 4, 3)).astype(np.float32)
        rollout = rollout_of(agent, of, seed=number, reward=1.0, ended=over, terminated=over & (kind == "terminated"))
        agent.learn(rollout._replace(observation=here, next_observation=here))
    rows = agent.network_input(here, rollout.desired_goal)
    value = agent.value(rows).numpy()
    np.testing.assert_allclose(value, 1 / (1 - 0.5) if kind == "truncated" else 1.0, rtol=0.05)


@pytest.mark.parametrize("action", [0.0, 1.0, 1e3, -1e6])
def test_log_probability_of_actions_far_outside_is_finite_and_so_is_its_gradient(action):
    policy = Gaussian(2, 0.05, "cpu")
    head, taken = torch.zeros(3, 2), torch.full((3, 2), action)
    assert torch.isfinite(policy.log_probability(head, taken)).all()
    assert torch.isfinite(policy.backward(head, taken, torch.ones(3), 0.0)).all()
    assert torch.isfinite(policy.gradient).all()


def test_learning_from_saturated_actions_stays_finite():
    of = signature()
    agent = made(of, std=1.0)
    metrics = agent.learn(rollout_of(agent, of, action=50.0))
    assert all(np.isfinite(float(value)) for value in metrics.values())
    assert np.isfinite(
        agent.act(*np.zeros((2, 1, 3), np.float32)[:1], np.zeros((1, 2), np.float32), explore=True)
    ).all()


def test_samples_have_the_spread_they_say_and_categories_their_probabilities():
    generator = torch.Generator().manual_seed(0)
    actions = Gaussian(1, 0.5, "cpu").sample(torch.full((20_000, 1), 3.0), generator)
    assert float(actions.mean()) == pytest.approx(3.0, abs=0.02)
    assert float(actions.std()) == pytest.approx(0.5, abs=0.02)
    odds = torch.tensor([0.2, 0.5, 0.3])
    chosen = Categorical(3).sample(odds.log().expand(20_000, 3), generator)
    counts = torch.bincount(chosen.long().flatten()) / 20_000
    torch.testing.assert_close(counts, odds, atol=0.02, rtol=0)


@pytest.mark.parametrize("discrete", [False, True])
def test_the_ratio_to_the_policy_that_played_is_one_in_the_first_minibatch(discrete):
    of = signature(labels=3 * discrete)
    agent = made(of, epochs=1, minibatches=1)
    for number in range(3):  # the statistics that inputs are normalised by have moved in between
        metrics = agent.learn(rollout_of(agent, of, steps=16, seed=number))
        assert float(metrics["kl"]) == pytest.approx(0, abs=1e-6)
        assert float(metrics["clip_fraction"]) == 0
        assert float(metrics["policy_loss"]) == pytest.approx(0, abs=1e-5), "minus the mean of normalised advantages"


def test_every_transition_is_learned_from_exactly_epochs_times(monkeypatch):
    of = signature()
    agent = made(of, epochs=3, minibatches=4)
    stored = np.arange(8)[:, None] < [8, 5, 0, 8]
    rollout = rollout_of(agent, of, stored=stored)
    seen: Counter[bytes] = Counter()
    update = PPO.update

    def counted(self: PPO, taken: Any) -> Any:
        seen.update(row.tobytes() for row in taken.action.numpy())
        return update(self, taken)

    monkeypatch.setattr(PPO, "update", counted)
    assert agent.learn(rollout)["updates"] == 12
    assert seen == Counter({row.tobytes(): 3 for row in rollout.action[stored]})


def test_learning_stops_when_the_policy_has_moved_far_enough():
    of = signature()
    whole, short = made(of, epochs=20), made(of, epochs=20, target_kl=1e-4)
    rollout = rollout_of(whole, of)
    assert whole.learn(rollout)["updates"] == 80
    metrics = short.learn(rollout)
    assert 1 <= metrics["updates"] < 80
    assert float(metrics["kl"]) < 1.5e-4


def test_the_better_of_two_actions_is_learned():
    for of in (signature(goal=0, action=1), signature(goal=0, labels=2)):
        agent = made(of, discount=0.0, learning_rate=1e-2)
        zeros = np.zeros((1, 3), np.float32), np.zeros((1, 0), np.float32)
        for number in range(15):
            rollout = rollout_of(agent, of, steps=16, seed=number)
            agent.learn(rollout._replace(reward=rollout.action[..., 0]))
        assert agent.act(*zeros, explore=False)[0, 0] > 0.5


def test_exploring_actions_are_not_clipped_and_tested_ones_are():
    of = signature()
    agent = made(of, std=3.0)
    here, goal = np.zeros((500, 3), np.float32), np.zeros((500, 2), np.float32)
    assert np.abs(agent.act(here, goal, explore=True)).max() > 2
    agent.policy.vector.fill_(5.0)
    np.testing.assert_array_equal(agent.act(here, goal, explore=False), np.ones((500, 2), np.float32))


def test_values_stay_as_they_are_when_their_scale_changes():
    of = signature()
    agent = made(of)
    agent.learn(rollout_of(agent, of))
    rows = torch.randn(50, 5)
    before = agent.value(rows)
    agent.value.update_scale(torch.linspace(-3000, 500, 1000))
    torch.testing.assert_close(agent.value(rows), before, rtol=1e-4, atol=1e-3)


def test_values_of_any_size_are_learned_alike():
    errors = []
    for scale in (1.0, 1000.0):
        of = signature(goal=0)
        agent = made(of, discount=0.0, learning_rate=1e-2, epochs=10, minibatches=1)
        for number in range(20):
            rollout = rollout_of(agent, of, steps=64, seed=number)
            metrics = agent.learn(rollout._replace(reward=scale * rollout.observation[..., 0]))
        errors.append(1 - float(metrics["explained_variance"]))
    assert max(errors) < 0.02


def test_the_policy_starts_near_zero_and_hidden_weights_are_orthogonal():
    agent = made(hidden=(32, 32))
    weight = agent.policy.named["layer1.weight"]
    torch.testing.assert_close(weight @ weight.T, 2 * torch.eye(32), atol=1e-4, rtol=0)
    last = agent.policy.named["layer2.weight"]
    torch.testing.assert_close(last @ last.T, 1e-4 * torch.eye(2), atol=1e-7, rtol=0)
    assert float(torch.linalg.vector_norm(agent.value.network.named["layer2.weight"])) == pytest.approx(1, abs=1e-4)
