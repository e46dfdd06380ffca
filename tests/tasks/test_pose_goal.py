"""Goals that are poses."""

from math import pi, radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from support.rig import made, part

from karolos.simulation.geometry import (
    angles,
    axes,
    columns,
    from_axes,
    inverse,
    multiply,
    nearest,
    rotated,
    rotation_about,
    rotation_vector,
    tilt_and_turn,
    tilted,
)
from karolos.tasks.pose_goal import PoseGoal, pose_array

short = st.tuples(*[st.floats(-1.7, 1.7)] * 3)  # shorter than pi
ORIGIN = (0.0, 0.0, 0.0)


@given(short, short)
def test_rotations_are_those_of_their_matrices(one, other):
    first, second = rotation_about(one), rotation_about(other)
    np.testing.assert_allclose(rotation_vector(first), one, atol=1e-9)
    a, b = np.transpose(axes(first)), np.transpose(axes(second))
    np.testing.assert_allclose(np.transpose(axes(multiply(first, second))), a @ b, atol=1e-12)
    np.testing.assert_allclose(rotated(first, other), a @ other, atol=1e-12)
    np.testing.assert_allclose(np.transpose(axes(from_axes(*axes(first)))), a, atol=1e-12)
    between = np.linalg.norm(rotation_vector(multiply(first, inverse(second))))
    found = angles(np.array(columns(first)), np.array(columns(second)))
    np.testing.assert_allclose(found, min(between, 2 * pi - between), atol=1e-3)


@given(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-2, 2), short)
def test_orientations_are_cut_to_their_range(x, y, turn, middle):
    around = rotation_about(middle)
    np.testing.assert_allclose(tilt_and_turn(around, tilted(around, x, y, turn)), (x, y, turn), atol=1e-9)
    tilt_x, tilt_y, turned = tilt_and_turn(around, nearest(around, 0.3, 0.8, tilted(around, x, y, turn)))
    tilt = np.hypot(x, y)
    np.testing.assert_allclose(np.hypot(tilt_x, tilt_y), min(tilt, 0.3), atol=1e-9)
    np.testing.assert_allclose(turned, np.clip(turn, -0.8, 0.8), atol=1e-9)


@pytest.mark.parametrize(("away", "turn", "reached"), [(0.009, 4, True), (0.011, 4, False), (0.009, 6, False)])
def test_a_pose_is_reached_by_position_and_angle(away, turn, reached):
    rule = PoseGoal(0.01, radians(5), dense=False, span=1.0)
    goal = pose_array(ORIGIN, rotation_about((0.0, 0.5, 0.0)))
    achieved = pose_array((away, 0, 0), multiply(rotation_about((0, 0, radians(turn))), rotation_about((0, 0.5, 0))))
    assert rule.success(achieved, goal) == reached
    assert rule.reward(achieved, goal) == (0 if reached else -1)


def test_symmetries_and_an_axis_leave_turns_without_effect():
    quarter, tilted = rotation_about((0, 0, pi / 2)), rotation_about((0.3, 0.2, 0.1))
    goal = pose_array(ORIGIN, tilted)
    square = PoseGoal(0.01, 0.1, dense=True, span=1.0, symmetries=[quarter])
    assert square.angle(pose_array(ORIGIN, multiply(tilted, inverse(quarter))), goal) == pytest.approx(0, abs=1e-3)
    assert square.angle(pose_array(ORIGIN, multiply(tilted, quarter)), goal) == pytest.approx(pi / 2, abs=1e-3)
    around = PoseGoal(0.01, 0.1, dense=True, span=1.0, axis=(0.0, 0.0, 1.0))
    for turn in (0.4, 2.0):
        turned = multiply(tilted, rotation_about((0.0, 0.0, turn)))
        assert around.angle(pose_array(ORIGIN, turned), goal) == pytest.approx(0, abs=1e-3)
    assert around.angle(pose_array(ORIGIN, multiply(tilted, rotation_about((0.5, 0, 0)))), goal) == pytest.approx(0.5)
    reversed_ = pose_array(ORIGIN, multiply(tilted, rotation_about((pi, 0.0, 0.0))))
    both = PoseGoal(0.01, 0.1, dense=True, span=1.0, axis=(0.0, 0.0, 1.0), symmetries=[(1.0, 0.0, 0.0, 0.0)])
    assert around.angle(reversed_, goal) == pytest.approx(pi, abs=1e-3)
    assert both.angle(reversed_, goal) == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize("control", ["pose", "impedance"])
def test_actions_in_the_frame_of_the_tool_move_it_along_its_own_axes(control):
    """Its z axis points down, and it is turned about it: a positive turn about z is one about the world's -z."""
    environment = made("reach_pose", arm={"control": control, "frame": "tool", "reset_noise": 0.0})
    environment.reset(0)
    before = environment.robot.tool
    for _ in range(4):
        environment.step(np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.5]))
    after = environment.robot.tool
    turned = rotation_vector(multiply(after.orientation, inverse(before.orientation)))
    assert after.position[2] < before.position[2] - 0.01
    assert turned[2] < -0.08
    assert np.linalg.norm(turned[:2]) < 0.02


@pytest.mark.parametrize("wrong", [(0, 500), (500, 200), (300, 300), (1, 1e9)])
def test_a_range_of_stiffness_rises_within_what_an_arm_can_have(wrong):
    with pytest.raises(ValidationError, match="stiffness_range"):
        part("robots", "panda", stiffness_range=wrong)


def test_a_seventh_number_chooses_the_stiffness_and_what_is_observed_has_noise():
    arm = {"control": "impedance", "stiffness_range": (100, 1600), "observe": ["wrench", "torques"]}
    environment = made("reach_pose", arm=arm)
    environment.reset(0)
    robot, layout = environment.robot, environment.signature.observation
    robot.apply("wrench_noise", 1.0)
    assert "stiffness" not in robot.parameters, "actions choose it"
    left = []
    for number in (-1.0, 1.0):
        environment.reset(0)
        goal = robot.tool_position[0] + robot.tool_step
        for first in (1.0, 0.0, 0.0, 0.0):
            step = environment.step(np.array([first, 0, 0, 0, 0, 0, number]))
        left.append(abs(goal - robot.tool_position[0]))
    assert left[1] < 0.5 * left[0]
    assert layout.slice("joint_torques").stop == layout.size
    assert 0.1 < np.abs(step.observation[layout.slice("wrench")][:3]).max() < 5
