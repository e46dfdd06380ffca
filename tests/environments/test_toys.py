"""The environments on which fast tests stand: a point that moves, and bits that are flipped until they match."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from karolos.core import Step
from karolos.environments.bit_flip import BitFlip
from karolos.environments.toy import Toy

seeds = st.integers(0, 2**63 - 1)


def made(bits: int = 6) -> BitFlip:
    return BitFlip(BitFlip.Settings(bits=bits))


def wrong(step: Step) -> list[int]:
    """The bits that differ from the goal's."""
    return np.flatnonzero(step.achieved_goal != step.desired_goal).tolist()


@given(bits=st.integers(1, 20), seed=seeds)
def test_flipping_what_is_wrong_reaches_the_goal_and_ends_the_episode(bits, seed):
    environment = made(bits)
    step = environment.reset(seed)
    assert (step.reward, step.terminated, step.truncated, step.success) == (0, False, False, False)
    flips = wrong(step)
    assert flips
    for count, bit in enumerate(flips, 1):
        assert not step.terminated
        step = environment.step(np.array(bit))
        assert step.reward == (0 if count == len(flips) else -1)
    assert step.terminated
    assert step.success
    assert not step.truncated
    with pytest.raises(RuntimeError, match="over"):
        environment.step(np.array(0))


@given(bits=st.integers(2, 20), seed=seeds)
def test_time_is_up_after_as_many_steps_as_there_are_bits(bits, seed):
    environment = made(bits)
    step = environment.reset(seed)
    bit = next(bit for bit in range(bits) if wrong(step) != [bit])
    rewards = []
    for count in range(1, bits + 1):
        step = environment.step(np.float32([bit]))
        rewards.append(step.reward)
        assert step.truncated == (count == bits)
        assert not step.terminated
    assert rewards == [-1] * bits
    with pytest.raises(RuntimeError, match="over"):
        environment.step(np.array(0))


def test_bits_and_goals_are_drawn_evenly_and_never_equal():
    environment = made(2)
    starts = [environment.reset(seed) for seed in range(1200)]
    pairs = {}
    for step in starts:
        key = (*step.observation.tolist(), *step.desired_goal.tolist())
        pairs[key] = pairs.get(key, 0) + 1
    assert len(pairs) == 4 * 3
    assert all(60 < count < 140 for count in pairs.values())  # 100 expected, standard deviation 10


@pytest.mark.parametrize("environment", [made(2), Toy(Toy.Settings(threshold=0.5))])
def test_goal_rule_works_over_leading_axes(environment):
    rule = environment.signature.goal_rule
    assert rule is not None
    achieved, desired = np.zeros((2, 3, 2), np.float32), np.zeros((2, 3, 2), np.float32)
    desired[1, 2] = 1
    reached = np.array([[True] * 3, [True, True, False]])
    np.testing.assert_array_equal(rule.success(achieved, desired), reached)
    np.testing.assert_array_equal(rule.terminated(achieved, desired), reached & isinstance(environment, BitFlip))
    np.testing.assert_array_equal(rule.reward(achieved, desired), np.where(reached, 0, -1))
    assert rule.reward(achieved, desired).dtype == np.float32
    assert rule.success(np.zeros(2), np.full(2, 0.3)) == isinstance(environment, Toy), "near the point, not the bits"


@pytest.mark.parametrize("action", [6, -1, 0.5, [0, 1]])
def test_a_bit_that_is_not_there_is_refused_by_name(action):
    environment = made()
    environment.reset(0)
    with pytest.raises(ValueError, match="BitFlip: an action is a number from 0 to 5"):
        environment.step(np.array(action))


def test_an_action_moves_the_point_by_speed_and_not_out_of_the_cube():
    toy = Toy(Toy.Settings(speed=0.25))
    with pytest.raises(RuntimeError, match="reset"):
        toy.step(np.zeros(2, np.float32))
    start = toy.reset(0).observation
    moved = toy.step(np.array([5, -0.5], np.float32)).observation
    np.testing.assert_allclose(moved, np.clip(start + np.array([0.25, -0.125]), -1, 1), rtol=1e-6)
    for _ in range(10):
        moved = toy.step(np.ones(2, np.float32)).observation
    assert moved.tolist() == [1, 1]


def test_picture_shows_which_bits_are_wrong_or_goal_and_point():
    bits = made()
    step = bits.reset(0)
    picture = bits.render(120, 40)
    assert (picture.shape, picture.dtype) == ((40, 120, 3), np.uint8)
    assert [bit for bit in range(6) if picture[10, 20 * bit + 10, 0] > picture[10, 20 * bit + 10, 2]] == wrong(step)
    for dimensions in (1, 2, 3):
        toy = Toy(Toy.Settings(dimensions=dimensions))
        toy.reset(0)
        picture = toy.render(64, 48)
        assert (picture.shape, picture.dtype) == ((48, 64, 3), np.uint8)
        colours = {tuple(colour) for colour in picture.reshape(-1, 3).tolist()}
        assert colours == {(255, 255, 255), (80, 170, 90), (40, 80, 200)}
