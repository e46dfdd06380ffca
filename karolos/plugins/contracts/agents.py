"""Promises of every agent."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np

from ...core import Agent, Discrete, Signature
from ...core.seeding import SeedTree
from ...errors import UsageError
from ...registry import load
from .buffers import SIGNATURE, noise
from .case import Candidate, Promises, demand, demand_same, demand_same_state, demand_shape, state_differences

PROMISES = Promises()
DISCRETE = replace(SIGNATURE, action=Discrete(("left", "right", "stay")))
SIZE, CALLS = 16, 8
"""Number of transitions of a batch, and of the calls that add them."""


@PROMISES
def actions_have_their_shape_and_range(one: Candidate) -> None:
    """Actions are float32, one row per observation, within [-1, 1] or the indices of a discrete set."""
    agent, signature = _made(one)
    for rows in (1, 7):
        data = noise(signature, 0, rows)
        for explore in (False, True):
            actions = agent.act(data.observation, data.desired_goal, explore=explore)
            demand_shape(actions, (rows, signature.action.size), "the array of actions", np.float32)
            if isinstance(signature.action, Discrete):
                allowed, indices = set(range(len(signature.action.labels))), set(actions.ravel().tolist())
                demand(indices <= allowed, f"the actions {sorted(indices)} are not among {sorted(allowed)}")
            elif explore and agent.on_policy:  # clipped only for the environment
                demand(np.isfinite(actions).all(), "an action is not finite")
            else:
                demand(np.abs(actions).max() <= 1, f"an action has the magnitude {np.abs(actions).max()}")


@PROMISES
def without_exploration_acting_is_deterministic_and_draws_nothing(one: Candidate) -> None:
    """Without exploration the same observation gives the same action, and acting does not change the state."""
    agent, signature = _made(one)
    data = noise(signature, 0, SIZE)
    before = agent.state()
    first, second = (agent.act(data.observation, data.desired_goal, explore=False) for _ in range(2))
    demand_same(first, second, "actions for the same observations")
    demand_same_state(before, agent.state(), "acting changes the agent's state", "draw only when exploring")


@PROMISES
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


@PROMISES
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


@PROMISES
def learning_goes_on_bit_for_bit_from_a_saved_state(one: Candidate) -> None:
    """An agent that loads a saved state continues to learn bit for bit like the agent that saved it."""
    (whole, signature), (first, _), (second, _) = _made(one), _made(one), _made(one, 5)
    for number in range(4):
        for agent in (whole, first if number < 2 else second):
            agent.learn(_experience(agent, signature, number))
        if number == 1:
            second.load_state(first.state())
    demand_same_state(whole.state(), second.state(), "learning after load_state differs", "the state is incomplete")


@PROMISES
def a_saved_state_does_not_change_with_the_agent(one: Candidate) -> None:
    """`state` returns copies, which later updates do not change."""
    agent, signature = _made(one)
    agent.learn(_experience(agent, signature, 0))
    saved = agent.state()
    copy = deepcopy(saved)
    agent.learn(_experience(agent, signature, 1))
    demand_same_state(copy, saved, "learning changes a state that was saved before", "return copies")
    demand(state_differences(saved, agent.state()), "an update does not change the state")


@PROMISES
def the_discount_is_below_one(one: Candidate) -> None:
    """The discount is in [0, 1)."""
    discount = _made(one)[0].discount
    demand(0 <= discount < 1, f"the discount {discount} is not in [0, 1)")


def _made(one: Candidate, seed: int = 0) -> tuple[Agent[Any], Signature]:
    """The agent with continuous actions, or with discrete ones if it refuses continuous ones."""
    try:
        return one.plugin(one.settled(), SIGNATURE, SeedTree(seed)), SIGNATURE
    except UsageError:
        return one.plugin(one.settled(), DISCRETE, SeedTree(seed)), DISCRETE


def _experience(agent: Agent[Any], signature: Signature, seed: int) -> Any:
    """A batch of noise, or a rollout for an on-policy agent."""
    plugin = load("buffers", "on_policy" if agent.on_policy else "uniform")
    settings = plugin.Settings(rollout=CALLS) if agent.on_policy else plugin.Settings()
    buffer = plugin(settings, signature, SeedTree(seed), environments=SIZE // CALLS, discount=0.95)
    for call in range(CALLS):
        buffer.add(noise(signature, seed + call, SIZE // CALLS)._replace(reward=np.ones(SIZE // CALLS, np.float32)))
    return buffer.sample(SIZE)
