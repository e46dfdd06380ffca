"""The toy environment, on which fast tests stand."""

import numpy as np
import pytest

from karolos.environments.toy import Toy


def test_an_action_moves_the_point_by_speed_and_not_out_of_the_cube():
    toy = Toy(Toy.Settings(speed=0.25))
    start = toy.reset(0).observation
    moved = toy.step(np.array([5, -0.5], np.float32)).observation
    np.testing.assert_allclose(moved, np.clip(start + np.array([0.25, -0.125]), -1, 1), rtol=1e-6)
    for _ in range(10):
        moved = toy.step(np.ones(2, np.float32)).observation
    assert moved.tolist() == [1, 1]


def test_goal_rule_works_over_leading_axes():
    rule = Toy(Toy.Settings(threshold=0.5)).signature.goal_rule
    achieved = np.zeros((2, 3, 2), np.float32)
    desired = np.zeros((2, 3, 2), np.float32)
    desired[1, 2] = 0.4
    desired[0, 1] = 0.3
    assert rule.success(achieved, desired).tolist() == [[True] * 3, [True, True, False]]
    assert rule.reward(achieved, desired).tolist() == [[0] * 3, [0, 0, -1]]


def test_no_step_without_a_running_episode():
    toy = Toy(Toy.Settings(max_steps=3))
    with pytest.raises(RuntimeError, match="reset"):
        toy.step(np.zeros(2, np.float32))
    toy.reset(0)
    assert [toy.step(np.zeros(2, np.float32)).truncated for _ in range(3)] == [False, False, True]
    with pytest.raises(RuntimeError, match="reset"):
        toy.step(np.zeros(2, np.float32))


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_picture_shows_goal_and_point(dimensions):
    toy = Toy(Toy.Settings(dimensions=dimensions))
    toy.reset(0)
    picture = toy.render(64, 48)
    assert picture.shape == (48, 64, 3)
    assert picture.dtype == np.uint8
    colours = {tuple(colour) for colour in picture.reshape(-1, 3).tolist()}
    assert colours == {(255, 255, 255), (80, 170, 90), (40, 80, 200)}
