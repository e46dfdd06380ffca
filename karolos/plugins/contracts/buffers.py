"""Promises of every buffer: replay buffers, and buffers that collect an on-policy agent's rollout."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core import Batch, Buffer, Field, FloatArray, Layout, Rollout, Signature, Transitions, random_actions
from ...core.seeding import SeedTree
from ...errors import KarolosError
from .case import Candidate, Promises, demand, demand_refusal, demand_same, demand_same_fields, demand_shape

ENVIRONMENTS = 3
CALLS = 20
ROLLOUT = CALLS * ENVIRONMENTS
REPLAY, ON_POLICY = Promises(), Promises()
SIGNATURE = Signature(
    observation=Layout((Field("x", 4),)),
    action=Layout((Field("a", 2),)),
    max_steps=10,
    achieved_goal=Layout((Field("reached", 2),)),
    desired_goal=Layout((Field("goal", 2),)),
)


@REPLAY
def a_batch_has_the_shapes_of_the_signature(one: Candidate) -> None:
    """A batch has the signature's shapes in float32, positive weights, and discounts in (0, discount]."""
    buffer = _made(one)
    _feed(buffer)
    batch = buffer.sample(12)
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("reward", "terminated", "discount", "weight", "slot"), (12,))
    shapes |= {"observation": (12, 4), "next_observation": (12, 4), "desired_goal": (12, 2), "action": (12, 2)}
    for field, array in batch._asdict().items():
        if array is None:
            demand(field not in shapes, f"a batch lacks {field}")
            continue
        demand_shape(array, shapes[field], field, np.int64 if field == "slot" else np.float32)
    demand((batch.weight > 0).all(), "a weight is not positive")
    allowed = (batch.discount > 0) & (batch.discount <= 0.9)
    demand(allowed.all(), "a discount is not in (0, .9], where the agent's is .9")
    demand(set(batch.terminated) <= {0.0, 1.0}, "a value of terminated is neither 0 nor 1")


@REPLAY
def transitions_can_be_sampled_before_their_episode_ends(one: Candidate) -> None:
    """Transitions can be sampled as soon as they are added, before their episode ends."""
    buffer = _made(one)
    _feed(buffer, calls=3)
    demand(len(buffer) == 3 * ENVIRONMENTS, f"len() is {len(buffer)} after {3 * ENVIRONMENTS} transitions were added")
    demand(set(buffer.sample(9).reward) <= set(range(9)), "a batch holds a reward that was never added")


@REPLAY
@ON_POLICY
def sampling_from_an_empty_buffer_is_an_error(one: Candidate) -> None:
    """Sampling from an empty buffer raises a KarolosError."""
    buffer = _made(one)
    demand(len(buffer) == 0, f"len() of a new buffer is {len(buffer)}")
    demand_refusal(lambda: buffer.sample(1), KarolosError, "sampling from an empty buffer raises no KarolosError")


@REPLAY
def sampling_goes_on_bit_for_bit_from_a_saved_state(one: Candidate) -> None:
    """A buffer that loads a saved state continues to sample bit for bit like the buffer that saved it."""
    first, second = _made(one), _made(one, 5)
    _feed(first)
    first.sample(6)
    second.load_state(first.state())
    for buffer in (first, second):
        _feed(buffer, first=CALLS, calls=5)
    demand(len(first) == len(second), f"len() after load_state is {len(second)} instead of {len(first)}")
    batch = Batch(*map(np.array, first.sample(15)))  # a copy, because a buffer may return views
    demand_same_fields(batch, second.sample(15), "a batch after load_state")


@REPLAY
def the_same_seed_samples_the_same_and_another_does_not(one: Candidate) -> None:
    """The seed determines which transitions are sampled; another seed samples others."""
    slots = []
    for seed in (0, 0, 1):
        buffer = _made(one, seed)
        _feed(buffer)
        slots.append(np.array(buffer.sample(15).slot))
    demand_same(slots[0], slots[1], "slots sampled with the same seed")
    demand(not np.array_equal(slots[0], slots[2]), "another seed samples the same transitions")


@ON_POLICY
def a_rollout_has_the_shapes_of_the_signature_and_is_given_once(one: Candidate) -> None:
    """A complete rollout is returned once and has the signature's shapes."""
    buffer = _made(one)
    _feed(buffer, calls=CALLS - 1)
    demand(len(buffer) == 0, "len() is not 0 before the rollout is complete")
    _feed(buffer, first=CALLS - 1, calls=1)
    demand(len(buffer) == ROLLOUT, f"len() of a complete rollout is {len(buffer)} instead of {ROLLOUT}")
    rollout = buffer.sample(len(buffer))
    size = CALLS, ENVIRONMENTS
    columns = {"observation": (4,), "next_observation": (4,), "desired_goal": (2,), "action": (2,)}
    for field in Rollout._fields:
        demand_shape(getattr(rollout, field), (*size, *columns.get(field, ())), field)
    demand_same(rollout.reward.ravel(), np.arange(ROLLOUT), "rewards in the order in which they were added")
    demand(len(buffer) == 0, "len() is not 0 after the rollout was returned")
    demand_refusal(lambda: buffer.sample(ROLLOUT), KarolosError, "a rollout is returned twice")


@ON_POLICY
def a_rollout_goes_on_bit_for_bit_from_a_saved_state(one: Candidate) -> None:
    """A buffer that loads a saved state completes the rollout bit for bit like the buffer that saved it."""
    first, second = _made(one), _made(one, 5)
    _feed(second, calls=7)
    _feed(first, calls=CALLS // 2)
    second.load_state(first.state())
    for buffer in (first, second):
        _feed(buffer, first=CALLS // 2, calls=CALLS - CALLS // 2)
    demand_same_fields(first.sample(len(first)), second.sample(len(second)), "a rollout after load_state")


def _made(one: Candidate, seed: int = 0) -> Buffer[Any]:
    """The buffer. Rollouts are complete after CALLS calls."""
    settings = one.settled(rollout=CALLS) if one.plugin.on_policy else one.settled()
    made: Buffer[Any] = one.plugin(settings, SIGNATURE, SeedTree(seed), environments=ENVIRONMENTS, discount=0.9)
    return made


def _feed(buffer: Buffer[Any], *, first: int = 0, calls: int = CALLS) -> None:
    """Noise from all environments. The reward of a transition is its number."""
    for call in range(first, first + calls):
        buffer.add(noise(SIGNATURE, call, ENVIRONMENTS))


def noise(signature: Signature, call: int, environments: int) -> Transitions:
    """Random transitions of this call. The reward of a transition is its number."""
    generator, numbers = np.random.default_rng(call), np.arange(environments)

    def columns(layout: Layout) -> FloatArray:
        return generator.normal(size=(environments, layout.size)).astype(np.float32)

    return Transitions(
        environment=numbers,
        observation=columns(signature.observation),
        achieved_goal=columns(signature.achieved_goal),
        desired_goal=columns(signature.desired_goal),
        action=random_actions(signature, environments, generator),
        reward=(call * environments + numbers).astype(np.float32),
        next_observation=columns(signature.observation),
        next_achieved_goal=columns(signature.achieved_goal),
        terminated=np.full(environments, call % 7 == 6),
        truncated=np.full(environments, call % 10 == 9),
    )
