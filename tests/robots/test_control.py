"""Joint control for arms of several numbers of joints, and ramps of joint speeds near the end of a range."""

from math import inf
from typing import Any

import numpy as np
import pytest
from support.rig import made

from karolos.buffers.augmentation import Augmentation
from karolos.core import Step
from karolos.core.experience import transition_layout
from karolos.environments.build import Facts
from karolos.environments.robot_task import RobotTask
from karolos.errors import UsageError
from karolos.robots.arm import Arm
from karolos.robots.control_kernel import ramp

SLOTS = {"control": "joint", "joint_slots": 8, "observe": ["rotation"]}


def arm_task(robot: str, **arm: Any) -> tuple[RobotTask, Arm]:
    environment = made("reach_pose", robot, arm={**SLOTS, **arm})
    assert isinstance(environment.robot, Arm)
    return environment, environment.robot


def test_arms_of_six_and_seven_joints_are_told_in_one_layout():
    (panda, seven), (ur5, six) = arm_task("panda"), arm_task("ur5")
    assert (seven.chain.size, six.chain.size) == (7, 6)
    trained, here = Facts.of(panda), Facts.of(ur5)
    assert here.differences(trained) == []
    layout, step = ur5.signature.observation, ur5.reset(0)
    for name in ("joint_effects", "joint_rooms", "joint_speeds", "joint_accelerations"):
        rows = step.observation[layout.slice(name)].reshape(8, -1)
        assert not rows[6:].any()
    assert step.observation[layout.slice("joint_effects")].reshape(8, 6)[:6].any(1).all()


def test_effects_of_an_action_say_where_the_tool_goes():
    environment, arm = arm_task("panda", acceleration=None)
    layout = environment.signature.observation
    step = environment.reset(0)

    def told(name: str, one: Step) -> np.ndarray:
        return one.observation[layout.slice(name)]

    action = 0.2 * np.random.default_rng(0).uniform(-1, 1, 8).astype(np.float32)
    before = told("tool_position", step)
    for _ in range(2):  # in the second one the speed is steady
        effects = told("joint_effects", step).reshape(8, 6)
        before, step = told("tool_position", step), environment.step(action)
    moved = told("tool_position", step) - before
    assert np.linalg.norm(moved - action @ effects[:, :3]) < 0.1 * np.linalg.norm(moved)
    shares = np.array(arm.joint_velocities) * arm.period / arm.joint_step
    np.testing.assert_allclose(told("joint_speeds", step)[:7], shares, atol=1e-6)
    rooms = told("joint_rooms", step).reshape(8, 2)[:7] * np.array(arm.joint_step)[:, None]
    at, low, high = (np.array(one) for one in (arm.joint_positions, arm.limits.lower, arm.limits.upper))
    near = rooms < 0.99 * 10 * np.array(arm.joint_step)[:, None]
    np.testing.assert_allclose(rooms[near], np.column_stack((at - low, high - at))[near], atol=1e-5)


def test_actions_of_missing_joints_do_nothing_and_the_expert_gives_none():
    (first, _), (second, _) = arm_task("ur5"), arm_task("ur5")
    first.reset(0), second.reset(0)
    action = first.expert().act()
    assert action.shape == (8,)
    assert not action[6:].any()
    other = action.copy()
    other[6:] = 1.0
    np.testing.assert_array_equal(first.step(action).observation, second.step(other).observation)


def test_places_that_do_not_fit_the_arm_or_its_control_are_refused():
    with pytest.raises(UsageError, match="this arm has 7 joints"):
        arm_task("panda", joint_slots=6)
    with pytest.raises(UsageError, match="control is pose, whose actions do not move joints"):
        arm_task("panda", control="pose")


def test_a_mirror_changes_what_joints_do_to_the_tool_and_no_action():
    signature = arm_task("panda")[0].signature
    signs = Augmentation(Augmentation.Settings(), signature)._signs
    layout = transition_layout(signature)
    effects = signature.observation.slice("joint_effects")
    assert signs[layout.slice("observation")][effects].tolist() == 8 * [1, -1, 1, -1, 1, -1]
    assert signs[layout.slice("action")].tolist() == 8 * [1]


@pytest.mark.parametrize("share", [1.0, 0.5, 0.25, 0.1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_that_brakes_slowly_stops_inside_its_range(share, sign):
    speed, period, ramps = 2.0, 1 / 24, np.empty((2, 1))
    joint = np.array([[-1.5], [1.5], [speed], [24 * speed * share], [speed * period], [0.0]])
    chain = np.zeros(3), np.zeros((2, 12))
    for room in np.linspace(0.05, 2.0, 40):  # it begins to brake at other speeds, elsewhere in a control step
        at, velocity = sign * (1.5 - room), 0.0
        state = np.array([[at], [0.0]])
        for _ in range(120):
            now = (np.array([one]) for one in (at, velocity))
            ramp(period, inf, joint, *chain, state, *now, np.zeros(18), np.array([sign * speed * period]), ramps)
            end = ramps[1, 0]
            assert abs(end - velocity) <= 24 * speed * share * period + 1e-9
            at, velocity = at + (velocity + end) / 2 * period, end
            assert sign * at < 1.5 or (sign * velocity < 0.02 * speed and sign * at < 1.506), "it meets no hard stop"
        assert sign * at > 1.499


@pytest.mark.parametrize(("robot", "most"), [("panda", 1e-3), ("ur5", 3e-4), ("iiwa", 3e-4)])
@pytest.mark.parametrize("control", ["cartesian", "pose"])
def test_a_tool_that_moves_sideways_at_its_lowest_place_does_not_sink(robot, most, control):
    environment = made("reach", robot, arm={"control": control})
    arm, size = environment.robot, environment.signature.action.size
    assert isinstance(arm, Arm)
    (*_, low), heights = arm.workspace.low, list[float]()
    for across in (1.0, -1.0):
        environment.reset(0)
        arm.place_tool((*arm.workspace.centre[:2], low + 0.02), 1.0)
        for side in (1.0,) * 6 + (-1.0,) * 12:
            arm.act([side, across * side, -1.0, *[0.0] * (size - 3)])
            environment.world.step()
            arm.read()
            heights.append(arm.tool_position[2])
    assert low - most < min(heights) < low + 1e-3
