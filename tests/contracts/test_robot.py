"""What every robot promises."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from building import CONTROLS, robot_task

from karolos.core import Array
from karolos.environments.robot_task import RobotTask
from karolos.registry import load, names
from karolos.seeding import Generator
from karolos.tasks.reach import Reach

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


@pytest.mark.parametrize("robot", names("robots"))
def test_every_joint_reaches_its_speed_when_it_goes_far(robot: str) -> None:
    made = robot_task(robot, "reach", control="joint")
    limits = made.robot.limits
    for joint, speed in enumerate(limits.velocity):
        fastest = 0.0
        for way in (-1.0, 1.0):  # one way may be short, or lead into the floor
            made.reset(0)
            action = np.zeros(made.signature.action.size)
            action[joint] = way
            for _ in range(12):
                made.step(action)
                fastest = max(fastest, abs(made.robot.joint_velocities[joint]))
        assert 0.9 * speed < fastest < 1.05 * speed
    made.close()


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


class Grasping(Reach):
    """Reach with a gripper that opens and closes."""

    uses_gripper = True


def shaken_cube(made: RobotTask) -> tuple[Array, float, float]:
    """Grip a cube of 4 cm and .1 kg, lift it and shake it for 1 s.

    Returns its poses (steps, 7) and, of the shake, its creep in the gripper and the fingers' largest difference in m.
    """
    made.reset(0)
    robot = made.robot
    if not hasattr(made, "cube"):
        made.cube = made.world.box((0.04, 0.04, 0.04), 0.1, (0.9, 0.4, 0.1, 1.0))  # type: ignore[attr-defined]
    cube = made.cube  # type: ignore[attr-defined]
    x = robot.workspace.centre[0]
    cube.place((x, 0.0, 0.02))
    poses: list[tuple[float, ...]] = []

    def step(action: Array) -> None:
        made.step(action)
        position, turn = cube.pose()
        poses.append((*position, *turn))

    for height, opening, count in ((0.02, 1.0, 30), (0.02, 0.0, 14), (0.3, 0.0, 20)):
        for _ in range(count):
            step(robot.towards((x, 0.0, height), opening))
    assert robot.pads_touching(cube) == 2

    def held() -> Array:
        tool = robot._at.tool  # type: ignore[attr-defined]
        return np.array([tool.x, tool.y, tool.z]) @ np.subtract(cube.pose()[0], tool.position)

    before, apart = held(), 0.0
    fingers = robot._drives.pads  # type: ignore[attr-defined]
    for shake in range(24):
        step(np.array([0.0, 1.0 if shake % 2 else -1.0, 1.0 if shake % 4 < 2 else -1.0, -1.0]))
        first, second = robot.body.joints(fingers)  # type: ignore[attr-defined]
        apart = max(apart, abs(first[0] - second[0]))
    return np.array(poses), float(np.linalg.norm(held() - before)), apart


def grasping(robot: str) -> RobotTask:
    kind = load("robots", robot)
    return RobotTask(
        RobotTask.Settings.model_validate({}),
        robot=kind(kind.Settings(control="cartesian")),
        task=Grasping(Grasping.Settings.model_validate({"max_steps": 1000})),
    )


@pytest.mark.parametrize("robot", names("robots"))
def test_gripped_cube_survives_a_shake_alike_in_a_fresh_and_a_reused_world(robot: str) -> None:
    made = grasping(robot)
    poses, creep, apart = shaken_cube(made)
    assert creep < 0.002
    assert apart < 0.001
    np.testing.assert_array_equal(shaken_cube(made)[0], poses)
    made.close()
    fresh = grasping(robot)
    np.testing.assert_array_equal(shaken_cube(fresh)[0], poses)
    fresh.close()
