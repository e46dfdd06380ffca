"""What every agent of the registry keeps to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from karolos.core import Agent, Batch, Discrete, Field, Layout, Rollout, Signature
from karolos.errors import UsageError
from karolos.registry import load, names
from karolos.seeding import SeedTree

CONTINUOUS = Signature(
    observation=Layout((Field("x", 4),)),
    action=Layout((Field("a", 2),)),
    max_steps=10,
    achieved_goal=Layout((Field("reached", 2),)),
    desired_goal=Layout((Field("goal", 2),)),
)
DISCRETE = replace(CONTINUOUS, action=Discrete(("left", "right", "stay")))


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Two threads that share a busy core wait for each other longer than they compute."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def made(name: str, seed: int = 0) -> tuple[Agent[Any], Signature]:
    """The agent with its default settings, for the first kind of action that it takes."""
    plugin = load("agents", name)
    try:
        return plugin(plugin.Settings(), CONTINUOUS, SeedTree(seed)), CONTINUOUS
    except UsageError:
        return plugin(plugin.Settings(), DISCRETE, SeedTree(seed)), DISCRETE


def some_batch(signature: Signature, seed: int, size: int = 16) -> Batch:
    generator = np.random.default_rng(seed)

    def noise(columns: int) -> np.ndarray:
        return generator.normal(size=(size, columns)).astype(np.float32)

    if isinstance(signature.action, Discrete):
        action = generator.integers(len(signature.action.labels), size=(size, 1)).astype(np.float32)
    else:
        action = np.tanh(noise(signature.action.size))
    return Batch(
        observation=noise(4),
        desired_goal=noise(2),
        action=action,
        reward=noise(1)[:, 0],
        next_observation=noise(4),
        terminated=(noise(1)[:, 0] > 1).astype(np.float32),
        discount=np.full(size, 0.95, np.float32),
        weight=np.ones(size, np.float32),
        slot=np.arange(size),
    )


def experience(agent: Agent[Any], signature: Signature, seed: int) -> Batch | Rollout:
    """16 transitions of noise, as this agent takes them."""
    batch = some_batch(signature, seed)
    if not agent.on_policy:
        return batch
    rows = batch._replace(terminated=batch.terminated > 0)._asdict()
    found = {name: rows[name].reshape(8, 2, *rows[name].shape[1:]) for name in Rollout._fields if name in rows}
    truncated = np.arange(16).reshape(8, 2) % 5 == 4
    return Rollout(**found, ended=found["terminated"] | truncated, stored=np.ones((8, 2), np.bool_))


def leaves(state: Any) -> list[np.ndarray]:
    if isinstance(state, dict):
        return [leaf for key in sorted(state, key=str) for leaf in leaves(state[key])]
    return [np.asarray(state)]


def same(first: Any, second: Any) -> bool:
    ours, theirs = leaves(first), leaves(second)
    return len(ours) == len(theirs) and all(np.array_equal(one, other) for one, other in zip(ours, theirs, strict=True))


@pytest.mark.parametrize("name", names("agents"))
@pytest.mark.parametrize("rows", [1, 7])
def test_actions_have_their_shape_and_range(name: str, rows: int) -> None:
    agent, signature = made(name)
    data = some_batch(signature, 0, rows)
    for explore in (False, True):
        actions = agent.act(data.observation, data.desired_goal, explore=explore)
        assert actions.shape == (rows, signature.action.size)
        assert actions.dtype == np.float32
        if isinstance(signature.action, Discrete):
            assert set(actions.ravel()) <= set(range(len(signature.action.labels)))
        elif explore and agent.on_policy:
            assert np.isfinite(actions).all(), "clipped for the environment only"
        else:
            assert np.abs(actions).max() <= 1


@pytest.mark.parametrize("name", names("agents"))
def test_without_exploration_acting_is_deterministic_and_draws_nothing(name: str) -> None:
    agent, signature = made(name)
    data = some_batch(signature, 0)
    before = agent.state()
    first = agent.act(data.observation, data.desired_goal, explore=False)
    np.testing.assert_array_equal(first, agent.act(data.observation, data.desired_goal, explore=False))
    assert same(before, agent.state())


@pytest.mark.parametrize("name", names("agents"))
def test_metrics_are_scalars_on_the_device_and_priorities_one_per_transition(name: str) -> None:
    agent, signature = made(name)
    metrics = dict(agent.learn(experience(agent, signature, 0)))
    priorities = metrics.pop("priorities", None)
    assert metrics.pop("updates", 1) >= 1
    assert metrics
    for value in metrics.values():
        assert isinstance(value, torch.Tensor)
        assert value.numel() == 1
        assert not value.requires_grad
    if priorities is not None:
        found = np.asarray(priorities)
        assert found.shape == (16,)
        assert (found >= 0).all()


@pytest.mark.parametrize("name", names("agents"))
def test_same_seed_learns_the_same_and_another_seed_does_not(name: str) -> None:
    states = []
    for seed in (0, 0, 1):
        agent, signature = made(name, seed)
        for number in range(3):
            agent.learn(experience(agent, signature, number))
        states.append(agent.state())
    assert same(states[0], states[1])
    assert not same(states[0], states[2])


@pytest.mark.parametrize("name", names("agents"))
def test_learning_goes_on_bit_for_bit_from_a_saved_state(name: str) -> None:
    (whole, signature), (first, _), (second, _) = made(name), made(name), made(name, 5)
    for number in range(4):
        for agent in (whole, first if number < 2 else second):
            agent.learn(experience(agent, signature, number))
        if number == 1:
            second.load_state(first.state())
    assert same(whole.state(), second.state())


@pytest.mark.parametrize("name", names("agents"))
def test_a_saved_state_does_not_change_with_the_agent(name: str) -> None:
    agent, signature = made(name)
    agent.learn(experience(agent, signature, 0))
    saved = agent.state()
    copies = [leaf.copy() for leaf in leaves(saved)]
    agent.learn(experience(agent, signature, 1))
    assert all(np.array_equal(one, other) for one, other in zip(copies, leaves(saved), strict=True))
    assert not same(saved, agent.state())


@pytest.mark.parametrize("name", names("agents"))
def test_the_discount_is_below_one(name: str) -> None:
    assert 0 <= made(name)[0].discount < 1
