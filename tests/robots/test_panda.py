from __future__ import annotations

from math import cos, pi, sin

import numpy as np
import pytest

from karolos.core import Array
from karolos.environments.robot_task import RobotTask
from karolos.errors import PluginError
from karolos.robots.panda import Panda
from karolos.simulation import urdf
from karolos.tasks.reach import Reach

# Franka Emika's interface documentation: a, d in m and alpha of the joints and the flange, after Craig
DENAVIT_HARTENBERG = (
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -pi / 2),
    (0.0, 0.316, pi / 2),
    (0.0825, 0.0, pi / 2),
    (-0.0825, 0.384, -pi / 2),
    (0.0, 0.0, pi / 2),
    (0.088, 0.0, pi / 2),
    (0.0, 0.107, 0.0),
)
POSES = (
    (0.0,) * 7,
    (0.0, 0.41, 0.0, -1.85, 0.0, 2.26, 0.79),
    (0.0, -pi / 4, 0.0, -3 * pi / 4, 0.0, pi / 2, pi / 4),
    (1.1, -0.6, 0.7, -2.2, -1.3, 1.9, 2.4),
)


def flange(pose: tuple[float, ...]) -> Array:
    """The flange's frame (4, 4), straight from the table."""
    frame = np.eye(4)
    for (a, d, alpha), theta in zip(DENAVIT_HARTENBERG, (*pose, 0.0), strict=True):
        frame = frame @ np.array(
            [
                [cos(theta), -sin(theta), 0, a],
                [sin(theta) * cos(alpha), cos(theta) * cos(alpha), -sin(alpha), -d * sin(alpha)],
                [sin(theta) * sin(alpha), cos(theta) * sin(alpha), cos(alpha), d * cos(alpha)],
                [0, 0, 0, 1],
            ]
        )
    return frame


def panda(**settings: object) -> Panda:
    return Panda(Panda.Settings.model_validate(settings))


@pytest.mark.parametrize("pose", POSES)
def test_forward_kinematics_is_that_of_the_published_table(pose: tuple[float, ...]) -> None:
    frame = flange(pose)
    tool = panda().chain.forward(pose).tool
    np.testing.assert_allclose(tool.position, frame[:3, 3] + 0.1034 * frame[:3, 2], atol=1e-6)
    np.testing.assert_allclose(tool.z, frame[:3, 2], atol=1e-6)
    # the hand sits on the flange turned by -45 degrees
    turned = (frame[:3, 0] - frame[:3, 1]) / 2**0.5
    np.testing.assert_allclose(tool.x, turned, atol=1e-6)


def test_tool_at_the_neutral_pose_is_where_it_is_known_to_be() -> None:
    assert panda().home == pytest.approx((0.638, 0.0, 0.199), abs=1e-3)


def test_links_are_the_joints_and_the_base() -> None:
    robot = urdf.read(Panda.model.urdf)
    assert len(robot.findall("link")) == 7 + 2 + 1


def test_mass_is_that_of_the_identified_links() -> None:
    masses = [float(mass.get("value", "nan")) for mass in urdf.read(Panda.model.urdf).iter("mass")]
    identified = 0.6298 + 4.9707 + 0.6469 + 3.2286 + 3.5879 + 1.2259 + 1.6666 + 0.7355 + 0.73 + 2 * 0.015
    assert sum(masses) == pytest.approx(identified, abs=1e-4)


class Grasping(Reach):
    """Reach with a gripper that opens and closes."""

    uses_gripper = True


def environment(task: type[Reach] = Reach, **settings: object) -> RobotTask:
    return RobotTask(
        RobotTask.Settings.model_validate({}),
        robot=panda(**settings),
        task=task(task.Settings.model_validate({"max_steps": 1000})),
    )


@pytest.mark.parametrize("control", ["joint", "cartesian"])
def test_gripper_opens_and_closes_and_its_fingers_agree(control: str) -> None:
    made = environment(Grasping, control=control)
    made.reset(0)
    where = made.signature.observation.slice("gripper_opening")
    action = np.zeros(made.signature.action.size)
    for wish, opening in ((-1.0, 0.0), (1.0, 1.0), (0.0, 0.5)):
        action[-1] = wish
        for _ in range(30):
            step = made.step(action)
        assert step.observation[where] == pytest.approx(opening, abs=0.03)
        first, second = made.robot.body.joints([7, 8])  # type: ignore[attr-defined]
        assert abs(first[0] - second[0]) < 1e-3
    made.close()


def test_gripped_cube_is_lifted_and_survives_a_shake() -> None:
    made = environment(Grasping)
    made.reset(0)
    robot = made.robot
    cube = made.world.box((0.04, 0.04, 0.04), 0.1, (0.9, 0.4, 0.1, 1.0))
    cube.place((0.5, 0.0, 0.02))
    for position, opening, count in (
        ((0.5, 0.0, 0.02), 1.0, 25),
        ((0.5, 0.0, 0.02), 0.0, 12),
        ((0.5, 0, 0.3), 0.0, 20),
    ):
        for _ in range(count):
            made.step(robot.towards(position, opening))
    assert robot.pads_touching(cube) == 2
    assert cube.pose()[0][2] > 0.25
    for shake in range(24):
        made.step(np.array([0.0, 1.0 if shake % 2 else -1.0, 1.0 if shake % 4 < 2 else -1.0, -1.0]))
        first, second = robot.body.joints([7, 8])  # type: ignore[attr-defined]
        assert abs(first[0] - second[0]) < 1e-3
    assert np.linalg.norm(np.subtract(cube.pose()[0], robot.tool_position)) < 0.02
    made.close()


def test_yaw_turns_the_gripper_and_is_seen() -> None:
    made = environment(yaw=True)
    start = made.reset(0)
    heading = made.signature.observation.slice("tool_heading")
    for _ in range(10):
        step = made.step(np.array([0.0, 0.0, 0.0, 0.5]))
    before, after = (np.arctan2(*s.observation[heading][::-1]) for s in (start, step))
    assert after - before > 0.4
    assert np.linalg.norm(step.achieved_goal - start.achieved_goal) < 0.01
    made.close()


def test_tool_that_cannot_be_placed_is_a_clear_error() -> None:
    made = environment()
    made.reset(0)
    with pytest.raises(PluginError, match="workspace"):
        made.robot.place_tool((1.5, 0.0, 0.2), 0.0)
    made.close()


def test_delayed_action_takes_effect_later() -> None:
    made = environment()
    started = made.reset(0).observation[:3]
    made.robot.apply("action_delay", 2.0)
    made.reset(0)
    push = np.array([1.0, 0.0, 0.0])
    moved = [float(np.linalg.norm(made.step(push).observation[:3] - started)) for _ in range(4)]
    assert max(moved[:2]) < 0.002
    assert moved[3] > 0.01
    made.close()


def test_noise_is_on_the_observation_and_not_on_the_goal() -> None:
    made = environment()
    made.reset(0)
    made.robot.apply("observation_noise", 0.05)
    step = made.reset(0)
    assert np.abs(step.observation[:3] - step.achieved_goal).max() > 0.001
    again = made.reset(0)
    np.testing.assert_array_equal(step.observation, again.observation)
    made.close()
