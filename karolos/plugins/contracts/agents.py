"""What every agent promises."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...core import Agent, Batch, Discrete, Field, FloatArray, Layout, Rollout, Signature
from ...core.seeding import SeedTree
from ...errors import UsageError
from .case import Candidate, demand, demand_same

CONTINUOUS = Signature(
    observation=Layout((Field("x", 4),)),
    action=Layout((Field("a", 2),)),
    max_steps=10,
    achieved_goal=Layout((Field("reached", 2),)),
    desired_goal=Layout((Field("goal", 2),)),
)
DISCRETE = replace(CONTINUOUS, action=Discrete(("left", "right", "stay")))
SIZE = 16
"""Transitions of an update."""


def actions_have_their_shape_and_range(one: Candidate) -> None:
    """Actions are float32, one row per observation, and within their range."""
    agent, signature = _made(one)
    for rows in (1, 7):
        data = _batch(signature, 0, rows)
        for explore in (False, True):
            actions = agent.act(data.observation, data.desired_goal, explore=explore)
            wanted = (rows, signature.action.size)
            demand(actions.shape == wanted, f"the actions have the shape {actions.shape} instead of {wanted}")
            demand(actions.dtype == np.float32, f"the actions are {actions.dtype} instead of float32")
            if isinstance(signature.action, Discrete):
                allowed, found = set(range(len(signature.action.labels))), set(actions.ravel().tolist())
                demand(found <= allowed, f"{sorted(found)} are no indices in {allowed}")
            elif explore and agent.on_policy:  # clipped for the environment only
                demand(np.isfinite(actions).all(), "an action is not finite")
            else:
                demand(np.abs(actions).max() <= 1, f"an action is {np.abs(actions).max()}, and 1 is the most")


def without_exploration_acting_is_deterministic_and_draws_nothing(one: Candidate) -> None:
    """Without exploration the same observation gives the same action, and the state stays as it is."""
    agent, signature = _made(one)
    data = _batch(signature, 0)
    before = agent.state()
    first, second = (agent.act(data.observation, data.desired_goal, explore=False) for _ in range(2))
    demand_same(first, second, "actions for the same observations")
    demand(_equal(before, agent.state()), "acting without exploration changes the agent's state")


def metrics_are_scalars_on_the_device_and_priorities_one_per_transition(one: Candidate) -> None:
    """`learn` gives scalar tensors without gradient, and may give priorities, one per transition."""
    agent, signature = _made(one)
    metrics = dict(agent.learn(_experience(agent, signature, 0)))
    priorities = metrics.pop("priorities", None)
    demand(metrics.pop("updates", 1) >= 1, "`updates` is less than 1")
    demand(metrics, "`learn` gives no metrics")
    for name, value in metrics.items():
        demand(hasattr(value, "numel") and value.numel() == 1, f"the metric {name} is no tensor of one number")
        demand(not value.requires_grad, f"the metric {name} holds on to its gradient: detach it")
    if priorities is not None:
        found = np.asarray(priorities)
        demand(found.shape == (SIZE,), f"{SIZE} transitions have priorities of the shape {found.shape}")
        demand((found >= 0).all(), "a priority is negative")


def the_same_seed_learns_the_same_and_another_does_not(one: Candidate) -> None:
    """Seed and batches alone determine what is learned, bit for bit."""
    states = []
    for seed in (0, 0, 1):
        agent, signature = _made(one, seed)
        for number in range(3):
            agent.learn(_experience(agent, signature, number))
        states.append(agent.state())
    demand(_equal(states[0], states[1]), "the same seed and batches led to different states: draw from the seeds given")
    demand(not _equal(states[0], states[2]), "another seed led to the very same state")


def learning_goes_on_bit_for_bit_from_a_saved_state(one: Candidate) -> None:
    """An agent that loads another's state learns on as that would have."""
    (whole, signature), (first, _), (second, _) = _made(one), _made(one), _made(one, 5)
    for number in range(4):
        for agent in (whole, first if number < 2 else second):
            agent.learn(_experience(agent, signature, number))
        if number == 1:
            second.load_state(first.state())
    demand(_equal(whole.state(), second.state()), "what is learned after load_state differs: the state lacks something")


def a_saved_state_does_not_change_with_the_agent(one: Candidate) -> None:
    """`state` gives copies: a checkpoint is not written to by the updates that follow."""
    agent, signature = _made(one)
    agent.learn(_experience(agent, signature, 0))
    saved = agent.state()
    copies = [leaf.copy() for leaf in _leaves(saved)]
    agent.learn(_experience(agent, signature, 1))
    kept = all(np.array_equal(ours, theirs) for ours, theirs in zip(copies, _leaves(saved), strict=True))
    demand(kept, "a state that was handed out changes when the agent learns: hand out copies")
    demand(not _equal(saved, agent.state()), "an update changes nothing in the state")


def the_discount_is_below_one(one: Candidate) -> None:
    """`discount` lies in [0, 1)."""
    discount = _made(one)[0].discount
    demand(0 <= discount < 1, f"the discount is {discount}")


PROMISES = (
    actions_have_their_shape_and_range,
    without_exploration_acting_is_deterministic_and_draws_nothing,
    metrics_are_scalars_on_the_device_and_priorities_one_per_transition,
    the_same_seed_learns_the_same_and_another_does_not,
    learning_goes_on_bit_for_bit_from_a_saved_state,
    a_saved_state_does_not_change_with_the_agent,
    the_discount_is_below_one,
)


def _made(one: Candidate, seed: int = 0) -> tuple[Agent[Any], Signature]:
    """The agent, for the first kind of action that it takes."""
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
    """Transitions of noise, as this agent takes them."""
    batch = _batch(signature, seed)
    if not agent.on_policy:
        return batch
    rows = batch._asdict() | {"terminated": batch.terminated > 0}
    found = {name: rows[name].reshape(8, 2, *rows[name].shape[1:]) for name in Rollout._fields if name in rows}
    truncated = np.arange(SIZE).reshape(8, 2) % 5 == 4
    return Rollout(**found, ended=found["terminated"] | truncated, stored=np.ones((8, 2), np.bool_))


def _leaves(state: Any) -> list[np.ndarray[Any, Any]]:
    if isinstance(state, dict):
        return [leaf for key in sorted(state, key=str) for leaf in _leaves(state[key])]
    return [np.asarray(state)]


def _equal(first: Any, second: Any) -> bool:
    ours, theirs = _leaves(first), _leaves(second)
    return len(ours) == len(theirs) and all(np.array_equal(one, other) for one, other in zip(ours, theirs, strict=True))
