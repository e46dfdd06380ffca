"""The toy environment, on which fast tests stand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from karolos.environments.toy import Toy

seeds = st.integers(0, 2**63 - 1)
toys = st.builds(
    Toy.Settings,
    dimensions=st.integers(1, 5),
    threshold=st.floats(0.05, 0.4),
    speed=st.floats(0.01, 2),
    max_steps=st.integers(1, 8),
    reward=st.sampled_from(["sparse", "dense"]),
)


def play(toy: Toy, seed: int, actions: np.ndarray) -> list[np.ndarray]:
    return [np.hstack(list(step)) for step in (toy.reset(seed), *(toy.step(action) for action in actions))]


@given(settings=toys, seed=seeds)
def test_same_seed_and_actions_give_the_same_episode_fresh_or_used(settings, seed):
    actions = np.random.default_rng(0).uniform(-1, 1, (settings.max_steps, settings.dimensions)).astype(np.float32)
    fresh, used = Toy(settings), Toy(settings)
    used.reset(seed + 1)
    used.step(actions[0])
    np.testing.assert_array_equal(play(fresh, seed, actions), play(used, seed, actions))


@given(settings=toys, seed=seeds)
def test_steps_are_as_the_signature_and_the_goal_rule_say(settings, seed):
    toy = Toy(settings)
    signature = toy.signature
    step = toy.reset(seed)
    assert (step.reward, step.terminated, step.truncated, step.success) == (0, False, False, False)
    for count in range(1, settings.max_steps + 1):
        step = toy.step(np.ones(settings.dimensions, np.float32))
        for array, layout in (
            (step.observation, signature.observation),
            (step.achieved_goal, signature.achieved_goal),
            (step.desired_goal, signature.desired_goal),
        ):
            assert array.shape == (layout.size,)
            assert array.dtype == np.float32
        assert step.reward == signature.goal_rule.reward(step.achieved_goal, step.desired_goal)
        assert step.success == signature.goal_rule.success(step.achieved_goal, step.desired_goal)
        assert signature.reward_range[0] <= step.reward <= signature.reward_range[1]
        assert not step.terminated
        assert step.truncated == (count == signature.max_steps)


def test_an_action_moves_the_point_by_speed_and_not_out_of_the_cube():
    toy = Toy(Toy.Settings(speed=0.25))
    start = toy.reset(0).observation
    moved = toy.step(np.array([5, -0.5], np.float32)).observation
    np.testing.assert_allclose(moved, np.clip(start + np.array([0.25, -0.125]), -1, 1), rtol=1e-6)
    for _ in range(10):
        moved = toy.step(np.ones(2, np.float32)).observation
    assert moved.tolist() == [1, 1]


def test_earlier_steps_stay_as_they_were():
    toy = Toy(Toy.Settings())
    first = toy.reset(0)
    kept = np.hstack(list(first))
    toy.step(np.ones(2, np.float32))
    toy.reset(1)
    np.testing.assert_array_equal(np.hstack(list(first)), kept)


def test_goal_rule_works_over_leading_axes():
    rule = Toy(Toy.Settings(threshold=0.5)).signature.goal_rule
    achieved = np.zeros((2, 3, 2), np.float32)
    desired = np.zeros((2, 3, 2), np.float32)
    desired[1, 2] = 0.4
    desired[0, 1] = 0.3
    assert rule.success(achieved, desired).tolist() == [[True] * 3, [True, True, False]]
    assert rule.reward(achieved, desired).tolist() == [[0] * 3, [0, 0, -1]]


def test_no_step_without_a_running_episode():
    toy = Toy(Toy.Settings(max_steps=1))
    with pytest.raises(RuntimeError, match="reset"):
        toy.step(np.zeros(2, np.float32))
    toy.reset(0)
    toy.step(np.zeros(2, np.float32))
    with pytest.raises(RuntimeError, match="reset"):
        toy.step(np.zeros(2, np.float32))


@pytest.mark.parametrize(
    "wrong", [{"dimensions": 0}, {"threshold": 0}, {"threshold": 1}, {"reward": "shaped"}, {"a": 1}]
)
def test_settings_without_sense_are_refused(wrong):
    with pytest.raises(ValidationError):
        Toy.Settings(**wrong)


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_picture_shows_goal_and_point(dimensions):
    toy = Toy(Toy.Settings(dimensions=dimensions))
    toy.reset(0)
    picture = toy.render(64, 48)
    assert picture.shape == (48, 64, 3)
    assert picture.dtype == np.uint8
    colours = {tuple(colour) for colour in picture.reshape(-1, 3).tolist()}
    assert colours == {(255, 255, 255), (80, 170, 90), (40, 80, 200)}
