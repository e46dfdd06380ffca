"""What every buffer of the registry keeps to."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from karolos.core import Batch, Buffer, Field, Layout, Rollout, Signature, Transitions
from karolos.errors import KarolosError
from karolos.registry import load, names
from karolos.seeding import SeedTree

ENVIRONMENTS = 3
CALLS = 20
REPLAY = [name for name in names("buffers") if not load("buffers", name).on_policy]
ON_POLICY = [name for name in names("buffers") if load("buffers", name).on_policy]
SIGNATURE = Signature(
    observation=Layout((Field("x", 4),)),
    action=Layout((Field("a", 2),)),
    max_steps=10,
    achieved_goal=Layout((Field("reached", 2),)),
    desired_goal=Layout((Field("goal", 2),)),
)


def made(name: str, seed: int = 0) -> Buffer[Any]:
    """The buffer with its default settings; a rollout is complete after CALLS calls."""
    plugin = load("buffers", name)
    settings = plugin.Settings(rollout=CALLS) if plugin.on_policy else plugin.Settings()
    buffer: Buffer[Any] = plugin(settings, SIGNATURE, SeedTree(seed), environments=ENVIRONMENTS, discount=0.9)
    return buffer


def feed(buffer: Buffer, *, first: int = 0, calls: int = CALLS) -> None:
    """Noise from all environments; each transition's reward is its number."""
    for call in range(first, first + calls):
        generator = np.random.default_rng(call)

        def noise(columns: int, generator: np.random.Generator = generator) -> np.ndarray:
            return generator.normal(size=(ENVIRONMENTS, columns)).astype(np.float32)

        numbers = np.arange(ENVIRONMENTS)
        buffer.add(
            Transitions(
                environment=numbers,
                observation=noise(4),
                achieved_goal=noise(2),
                desired_goal=noise(2),
                action=np.tanh(noise(2)),
                reward=(call * ENVIRONMENTS + numbers).astype(np.float32),
                next_observation=noise(4),
                next_achieved_goal=noise(2),
                terminated=np.full(ENVIRONMENTS, call % 7 == 6),
                truncated=np.full(ENVIRONMENTS, call % 10 == 9),
            )
        )


def copied(batch: Batch) -> Batch:
    return Batch(*(np.array(field) for field in batch))


@pytest.mark.parametrize("name", REPLAY)
def test_a_batch_has_the_shapes_of_the_signature(name: str) -> None:
    buffer = made(name)
    feed(buffer)
    batch = buffer.sample(12)
    given = {field: array for field, array in batch._asdict().items() if array is not None}
    shapes = {field: array.shape for field, array in given.items()}
    numbers = dict.fromkeys(("reward", "terminated", "discount", "weight", "slot"), (12,))
    vectors = {"observation": (12, 4), "next_observation": (12, 4), "desired_goal": (12, 2), "action": (12, 2)}
    assert shapes == numbers | vectors
    assert all(array.dtype == np.float32 for field, array in given.items() if field != "slot")
    assert batch.slot.dtype == np.int64
    assert (batch.weight > 0).all()
    assert ((batch.discount > 0) & (batch.discount <= 0.9)).all()
    assert set(batch.terminated) <= {0.0, 1.0}


@pytest.mark.parametrize("name", REPLAY)
def test_transitions_can_be_sampled_before_their_episode_ends(name: str) -> None:
    buffer = made(name)
    feed(buffer, calls=3)
    assert len(buffer) == 3 * ENVIRONMENTS
    assert set(buffer.sample(9).reward) <= set(range(9))


@pytest.mark.parametrize("name", names("buffers"))
def test_an_empty_buffer_says_so(name: str) -> None:
    buffer = made(name)
    assert len(buffer) == 0
    with pytest.raises(KarolosError):
        buffer.sample(1)


@pytest.mark.parametrize("name", REPLAY)
def test_sampling_goes_on_bit_for_bit_from_a_saved_state(name: str) -> None:
    first, second = made(name), made(name, 5)
    feed(first)
    first.sample(6)
    second.load_state(first.state())
    for buffer in (first, second):
        feed(buffer, first=20, calls=5)
    assert len(first) == len(second)
    for ours, theirs in zip(copied(first.sample(15)), copied(second.sample(15)), strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("name", REPLAY)
def test_same_seed_samples_the_same_and_another_seed_does_not(name: str) -> None:
    batches = []
    for seed in (0, 0, 1):
        buffer = made(name, seed)
        feed(buffer)
        batches.append(copied(buffer.sample(15)))
    np.testing.assert_array_equal(batches[0].slot, batches[1].slot)
    assert not np.array_equal(batches[0].slot, batches[2].slot)


@pytest.mark.parametrize("name", ON_POLICY)
def test_a_rollout_has_the_shapes_of_the_signature_and_is_given_once(name: str) -> None:
    buffer = made(name)
    feed(buffer, calls=CALLS - 1)
    assert len(buffer) == 0
    feed(buffer, first=CALLS - 1, calls=1)
    assert len(buffer) == CALLS * ENVIRONMENTS
    rollout = buffer.sample(len(buffer))
    size = CALLS, ENVIRONMENTS
    vectors = {"observation": (*size, 4), "next_observation": (*size, 4), "desired_goal": (*size, 2)}
    shapes = {field: getattr(rollout, field).shape for field in Rollout._fields}
    assert shapes == dict.fromkeys(Rollout._fields, size) | vectors | {"action": (*size, 2)}
    np.testing.assert_array_equal(rollout.reward.ravel(), np.arange(CALLS * ENVIRONMENTS))
    assert len(buffer) == 0
    with pytest.raises(KarolosError):
        buffer.sample(CALLS * ENVIRONMENTS)


@pytest.mark.parametrize("name", ON_POLICY)
def test_a_rollout_goes_on_bit_for_bit_from_a_saved_state(name: str) -> None:
    first, second = made(name), made(name, 5)
    feed(second, calls=7)
    feed(first, calls=CALLS // 2)
    second.load_state(first.state())
    for buffer in (first, second):
        feed(buffer, first=CALLS // 2, calls=CALLS - CALLS // 2)
    ours, theirs = (buffer.sample(len(buffer)) for buffer in (first, second))
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(one, other)
