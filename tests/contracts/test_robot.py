"""What every robot promises."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from building import CONTROLS, robot_task

from karolos.environments.robot_task import RobotTask
from karolos.registry import names
from karolos.seeding import Generator

LONG = 100_000


@pytest.fixture(scope="module", params=list(itertools.product(names("robots"), CONTROLS)), ids="-".join)
def environment(request: pytest.FixtureRequest) -> Iterator[RobotTask]:
    robot, control = request.param
    made = robot_task(robot, "reach", control=control, max_steps=LONG)
    yield made
    made.close()


def generator() -> Generator:
    return np.random.Generator(np.random.PCG64(0))


def test_no_joint_exceeds_its_speed_under_the_hardest_actions(environment: RobotTask) -> None:
    limits = environment.robot.limits
    draws = generator()
    environment.reset(0)
    fastest = np.zeros(len(limits.velocity))
    action = np.ones(environment.signature.action.size)
    for step in range(300):
        if step % 5 == 0 or step > 150:  # full turns to and fro, first held, then every step
            action = np.sign(draws.uniform(-1, 1, action.size))
        environment.step(action)
        joints = environment.robot.body.joints(range(len(limits.velocity)))  # type: ignore[attr-defined]
        fastest = np.maximum(fastest, [abs(state[1]) for state in joints])
        positions = np.array([state[0] for state in joints])
        assert (positions > np.array(limits.lower) - 0.02).all()
        assert (positions < np.array(limits.upper) + 0.02).all()
    assert (fastest <= 1.05 * np.array(limits.velocity)).all()
    assert (fastest > 0.5 * np.array(limits.velocity)).any(), "the actions were not hard"


def test_tool_reaches_every_corner_of_the_declared_workspace(environment: RobotTask) -> None:
    robot = environment.robot
    box = robot.workspace
    worst = 0.0
    for share in itertools.product((0.0, 0.5, 1.0), repeat=3):
        target = tuple(low + (high - low) * part for low, high, part in zip(box.low, box.high, share, strict=True))
        environment.reset(0)
        for _ in range(45):
            environment.step(robot.towards(target, 0.0))  # type: ignore[arg-type]
        worst = max(worst, float(np.linalg.norm(np.subtract(robot.tool_position, target))))
    assert worst < 0.005


def test_arm_at_rest_stays_where_it_is(environment: RobotTask) -> None:
    before = environment.reset(1).achieved_goal
    for _ in range(48):
        step = environment.step(np.zeros(environment.signature.action.size))
    assert np.linalg.norm(step.achieved_goal - before) < 0.002


def test_tool_state_is_that_of_the_physics(environment: RobotTask) -> None:
    """Kinematics in plain floats against the position of the last link and its velocity in the world."""
    robot = environment.robot
    draws = generator()
    environment.reset(2)
    for _ in range(10):
        before = np.array(robot.tool_position)
        environment.step(draws.uniform(-1, 1, environment.signature.action.size))
        travelled = (np.array(robot.tool_position) - before) * 24
        assert np.linalg.norm(travelled) < 3
        last = len(robot.limits.lower) - 1
        state = robot.body.link(last, moved=True)  # type: ignore[attr-defined]
        offset = np.array(robot.tool_position) - state.position
        np.testing.assert_allclose(np.linalg.norm(offset), np.linalg.norm(robot.model.tool), atol=1e-6)  # type: ignore[attr-defined]
        arm = np.array(robot.tool_position) - state.centre
        velocity = np.array(state.velocity) + np.cross(state.angular_velocity, arm)
        np.testing.assert_allclose(robot.tool_velocity, velocity, atol=1e-5)


def test_home_lies_in_the_workspace_and_the_tool_points_down(environment: RobotTask) -> None:
    robot = environment.robot
    assert robot.workspace.contains(robot.home)
    pose = robot.chain.forward(robot.model.home).tool  # type: ignore[attr-defined]
    np.testing.assert_allclose(pose.z, (0, 0, -1), atol=1e-3)


def test_tool_can_be_placed_at_a_reset(environment: RobotTask) -> None:
    environment.reset(0)
    target = environment.robot.workspace.centre
    environment.robot.place_tool(target, 1.0)
    assert np.linalg.norm(np.subtract(environment.robot.tool_position, target)) < 0.001


@pytest.mark.parametrize("parameter", ["joint_damping", "joint_friction", "link_mass", "motor_gain"])
def test_each_parameter_changes_the_motion_and_can_be_taken_back(environment: RobotTask, parameter: str) -> None:
    def end() -> np.ndarray:
        draws = generator()
        environment.reset(0)
        for _ in range(10):
            step = environment.step(draws.uniform(-1, 1, environment.signature.action.size))
        return step.observation

    declared = environment.robot.parameters[parameter]
    nominal = end()
    environment.robot.apply(parameter, declared.high)
    changed = end()
    environment.robot.apply(parameter, declared.nominal)
    assert np.abs(changed - nominal).max() > 1e-5
    np.testing.assert_array_equal(end(), nominal)
