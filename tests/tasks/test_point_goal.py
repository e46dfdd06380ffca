import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from karolos.errors import RunError
from karolos.simulation.interface import Box
from karolos.tasks.point_goal import Places, PointGoal, sample_position
from karolos.tasks.pose_goal import PoseGoal
from karolos.tasks.slide import Rest
from karolos.tasks.throw import Landing

points = arrays(np.float32, (5, 3), elements=st.floats(-2, 2, width=32))
SPARSE = PointGoal(0.05, dense=False, span=10.0)
DENSE = PointGoal(0.05, dense=True, span=10.0)


@given(points, points)
def test_reward_and_success_agree(achieved, desired):
    success = SPARSE.success(achieved, desired)
    distance = np.linalg.norm(achieved.astype(float) - desired, axis=-1)
    clear = abs(distance - 0.05) > 1e-6
    np.testing.assert_array_equal(success[clear], (distance < 0.05)[clear])
    np.testing.assert_array_equal(SPARSE.reward(achieved, desired), np.where(success, 0, -1).astype(np.float32))
    np.testing.assert_allclose(DENSE.reward(achieved, desired), -distance, atol=1e-5)
    np.testing.assert_array_equal(DENSE.success(achieved, desired), success)


@given(points, points)
def test_rewards_lie_in_the_declared_range(achieved, desired):
    for rule in (SPARSE, DENSE):
        rewards = rule.reward(achieved, desired)
        assert rewards.dtype == np.float32
        assert (rewards >= rule.reward_range[0]).all()
        assert (rewards <= rule.reward_range[1]).all()


class Kinder(PointGoal):
    def reward(self, achieved, desired):
        return np.zeros(achieved.shape[:-1], np.float32)


def test_only_a_rule_whose_reward_follows_from_success_says_so():
    assert SPARSE.sparse
    assert PoseGoal(0.05, 0.1, dense=False, span=1.0).sparse
    others = DENSE, Places(0.05), Kinder(0.05, dense=False, span=1.0), Landing(0.05, dense=False, failure_cost=0.5)
    assert not any(rule.sparse for rule in (*others, Rest(0.05, dense=False, span=1.0, reward_share=1.0)))


def test_reaching_a_goal_ends_nothing():
    assert not SPARSE.terminated(np.zeros((4, 3)), np.zeros((4, 3))).any()


def test_sampled_positions_are_uniform_in_the_box_and_accepted():
    generator = np.random.Generator(np.random.PCG64(0))
    box = Box((0.0, -1.0, 2.0), (1.0, 1.0, 2.5))
    found = np.array([sample_position(generator, box, "it", lambda point: point[0] > 0.5) for _ in range(500)])
    assert all(box.contains(point, 1e-6) for point in found)
    assert found[:, 0].min() > 0.5
    np.testing.assert_allclose(found.mean(0), (0.75, 0.0, 2.25), atol=0.08)


def test_no_place_is_a_named_error_after_bounded_attempts():
    generator = np.random.Generator(np.random.PCG64(0))
    with pytest.raises(RunError, match="no place for the cube"):
        sample_position(generator, Box((0, 0, 0), (1, 1, 1)), "the cube", lambda point: False)


def test_each_thing_in_its_place_counts_and_the_last_when_all_are_left_alone():
    rule, goal = Places(0.015), np.array((0, 0, 0.04, 0, 0, 0.04, 1), np.float32)
    assert rule.reward(np.zeros((0, 7), np.float32), np.zeros((0, 7), np.float32)).shape == (0,), (
        "a batch without goals"
    )
    placed, off = (0, 0, 0.04), (0.1, 0, -0.04)
    achieved = np.array([(*off, *off, 1), (*placed, *off, 0), (*placed, *placed, 0), (*placed, *placed, 1)], np.float32)
    assert rule.reward(achieved, goal).tolist() == [-1, -0.5, -0.5, 0]
    assert rule.success(achieved, goal).tolist() == [False, False, False, True]
    one = np.array([(*off, 1), (*placed, 0), (*placed, 1)], np.float32)
    assert rule.reward(one, goal[3:]).tolist() == [-1, -1, 0]
    assert rule.reward(one, np.array((*placed, 0), np.float32)).tolist() == [-1, 0, 0]
