"""Promises of every agent."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np

from ...core import Agent, Batch, Discrete, Field, FloatArray, Layout, Rollout, Signature
from ...core.seeding import SeedTree
from ...errors import UsageError
from .case import Candidate, demand, demand_same, demand_same_state, demand_shape, state_differences

CONTINUOUS = Signature(
    observation=Layout((Field("x", 4),)),
    action=Layout((Field("a", 2),)),
    max_steps=10,
    achieved_goal=Layout((Field("reached", 2),)),
    desired_goal=Layout((Field("goal", 2),)),
)
DISCRETE = replace(CONTINUOUS, action=Discrete(("left", "right", "stay")))
SIZE = 16
"""Transitions of a batch."""


def actions_have_their_shape_and_range(one: Candidate) -> None:
    """Actions are float32, one row per observation, within [-1, 1] or the indices of a discrete set."""
    agent, signature = _made(one)
    for rows in (1, 7):
        data = _batch(signature, 0, rows)
        for explore in (False, True):
            actions = agent.act(data.observation, data.desired_goal, explore=explore)
            demand_shape(actions, (rows, signature.action.size), "the array of actions", np.float32)
            if isinstance(signature.action, Discrete):
                allowed, indices = set(range(len(signature.action.labels))), set(actions.ravel().tolist())
                demand(indices <= allowed, f"the actions {sorted(indices)} are not among {sorted(allowed)}")
            elif explore and agent.on_policy:  # clipped for the environment only
                demand(np.isfinite(actions).all(), "an action is not finite")
            else:
                demand(np.abs(actions).max() <= 1, f"an action has the magnitude {np.abs(actions).max()}")


def without_exploration_acting_is_deterministic_and_draws_nothing(one: Candidate) -> None:
    """Without exploration the same observation gives the same action, and acting does not change the state."""
    agent, signature = _made(one)
    data = _batch(signature, 0)
    before = agent.state()
    first, second = (agent.act(data.observation, data.desired_goal, explore=False) for _ in range(2))
    demand_same(first, second, "actions for the same observations")
    demand_same_state(before, agent.state(), "acting changes the agent's state", "draw only when exploring")


def metrics_are_scalars_and_priorities_one_per_transition(one: Candidate) -> None:
    """`learn` returns metrics as scalar tensors without gradient, and optionally priorities, one per transition."""
    agent, signature = _made(one)
    metrics = dict(agent.learn(_experience(agent, signature, 0)))
    priorities = metrics.pop("priorities", None)
    demand(metrics.pop("updates", 1) >= 1, "`updates` is less than 1")
    demand(metrics, "`learn` returns no metrics")
    for name, value in metrics.items():
        demand(hasattr(value, "numel") and value.numel() == 1, f"the metric {name} is not a tensor with one number")
        demand(not value.requires_grad, f"the metric {name} requires a gradient: detach it")
    if priorities is not None:
        demand_shape(np.asarray(priorities), (SIZE,), "the array of priorities")
        demand((np.asarray(priorities) >= 0).all(), "a priority is negative")


def the_same_seed_learns_the_same_and_another_does_not(one: Candidate) -> None:
    """Seed and batches determine the state after learning, bit for bit; another seed gives another state."""
    states = []
    for seed in (0, 0, 1):
        agent, signature = _made(one, seed)
        for number in range(3):
            agent.learn(_experience(agent, signature, number))
        states.append(agent.state())
    demand_same_state(states[0], states[1], "the same seed and batches lead to different states", "use the given seeds")
    demand(state_differences(states[0], states[2]), "another seed leads to the same state")


def learning_goes_on_bit_for_bit_from_a_saved_state(one: Candidate) -> None:
    """An agent that loads a saved state continues to learn bit for bit like the agent that saved it."""
    (whole, signature), (first, _), (second, _) = _made(one), _made(one), _made(one, 5)
    for number in range(4):
        for agent in (whole, first if number < 2 else second):
            agent.learn(_experience(agent, signature, number))
        if number == 1:
            second.load_state(first.state())
    demand_same_state(whole.state(), second.state(), "learning after load_state differs", "the state is incomplete")


def a_saved_state_does_not_change_with_the_agent(one: Candidate) -> None:
    """`state` returns copies, which later updates do not change."""
    agent, signature = _made(one)
    agent.learn(_experience(agent, signature, 0))
    saved = agent.state()
    copy = deepcopy(saved)
    agent.learn(_experience(agent, signature, 1))
    demand_same_state(copy, saved, "learning changes a state that was saved before", "return copies")
    demand(state_differences(saved, agent.state()), "an update does not change the state")


def the_discount_is_below_one(one: Candidate) -> None:
    """The discount is in [0, 1)."""
    discount = _made(one)[0].discount
    demand(0 <= discount < 1, f"the discount {discount} is not in [0, 1)")


PROMISES = (
    actions_have_their_shape_and_range,
    without_exploration_acting_is_deterministic_and_draws_nothing,
    metrics_are_scalars_and_priorities_one_per_transition,
    the_same_seed_learns_the_same_and_another_does_not,
    learning_goes_on_bit_for_bit_from_a_saved_state,
    a_saved_state_does_not_change_with_the_agent,
    the_discount_is_below_one,
)


def _made(one: Candidate, seed: int = 0) -> tuple[Agent[Any], Signature]:
    """The agent with continuous actions, or with discrete ones where it refuses those."""
    try:
        return one.plugin(one.settled(), CONTINUOUS, SeedTree(seed)), CONTINUOUS
    except UsageError:
        return one.plugin(one.settled(), DISCRETE, SeedTree(seed)), DISCRETE


def _batch(signature: Signature, seed: int, size: int = SIZE) -> Batch:
    """Transitions of noise."""
    generator = np.random.default_rng(seed)

    def noise(columns: int) -> FloatArray:
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


def _experience(agent: Agent[Any], signature: Signature, seed: int) -> Batch | Rollout:
    """A batch of noise, or a rollout for an on-policy agent."""
    batch = _batch(signature, seed)
    if not agent.on_policy:
        return batch
    rows = batch._asdict() | {"terminated": batch.terminated > 0}
    found = {name: rows[name].reshape(8, 2, *rows[name].shape[1:]) for name in Rollout._fields if name in rows}
    truncated = np.arange(SIZE).reshape(8, 2) % 5 == 4
    return Rollout(**found, ended=found["terminated"] | truncated, stored=np.ones((8, 2), np.bool_))
