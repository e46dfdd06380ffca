"""Forward kinematics and masses are those that the makers publish."""

from collections.abc import Sequence
from math import cos, pi, sin

import numpy as np
import pytest

from karolos.core import Array
from karolos.registry import load
from karolos.robots.panda import Panda

TABLES = {
    "panda": (  # Franka Emika's interface documentation
        (0.0, 0.333, 0.0),
        (0.0, 0.0, -pi / 2),
        (0.0, 0.316, pi / 2),
        (0.0825, 0.0, pi / 2),
        (-0.0825, 0.384, -pi / 2),
        (0.0, 0.0, pi / 2),
        (0.088, 0.0, pi / 2),
        (0.0, 0.107, 0.0),
    ),
    "ur5": (  # Universal Robots, from the standard convention
        (0.0, 0.089159, 0.0),
        (0.0, 0.0, pi / 2),
        (-0.425, 0.0, 0.0),
        (-0.39225, 0.10915, 0.0),
        (0.0, 0.09465, pi / 2),
        (0.0, 0.0823, -pi / 2),
        (0.0, 0.0, 0.0),
    ),
    "iiwa": (  # LBR iiwa 14 R820: .36, .42, .40, and .126 to the flange; from the standard convention
        (0.0, 0.36, 0.0),
        (0.0, 0.0, -pi / 2),
        (0.0, 0.42, pi / 2),
        (0.0, 0.0, pi / 2),
        (0.0, 0.40, -pi / 2),
        (0.0, 0.0, -pi / 2),
        (0.0, 0.126, pi / 2),
        (0.0, 0.0, 0.0),
    ),
}
"""a, d in m and alpha of each joint and of the flange, after Craig."""
TO_TOOL = {"panda": 0.1034, "ur5": 0.137, "iiwa": 0.137}
"""m from the flange to the tool."""


def turned(angle: float, axis: str) -> Array:
    k, s = cos(angle), sin(angle)
    rotation = [[k, -s, 0], [s, k, 0], [0, 0, 1]] if axis == "z" else [[1, 0, 0], [0, k, -s], [0, s, k]]
    return np.block([[np.array(rotation), np.zeros((3, 1))], [np.zeros((1, 3)), np.eye(1)]])


def moved(x: float, z: float) -> Array:
    frame = np.eye(4)
    frame[[0, 2], 3] = x, z
    return frame


def flange(robot: str, pose: Sequence[float]) -> Array:
    """The flange's frame (4, 4), straight from the table."""
    # the base of the UR5's URDF is that of the table turned by pi, as in ur_description
    frame = turned(pi if robot == "ur5" else 0.0, "z")
    for (a, d, alpha), angle in zip(TABLES[robot], (*pose, 0.0), strict=True):
        frame = frame @ turned(alpha, "x") @ moved(a, 0) @ turned(angle, "z") @ moved(0, d)
    return frame


@pytest.mark.parametrize("robot", TO_TOOL)
@pytest.mark.parametrize("pose", [(0.0,) * 7, None, (1.1, -0.6, 0.7, -2.2, -1.3, 1.9, 2.4)], ids=str)
def test_forward_kinematics_is_that_of_the_published_table(robot, pose):
    plugin = load("robots", robot)
    home = plugin.model.home
    joints = home if pose is None else pose[: len(home)]
    frame, tool = flange(robot, joints), plugin(plugin.Settings()).forward(joints).tool
    np.testing.assert_allclose(tool.position, frame[:3, 3] + TO_TOOL[robot] * frame[:3, 2], atol=1e-6)
    np.testing.assert_allclose(tool.z, frame[:3, 2], atol=1e-6)
    if robot == "panda":  # the hand sits on the flange turned by -45 degrees
        np.testing.assert_allclose(tool.x, (frame[:3, 0] - frame[:3, 1]) / 2**0.5, atol=1e-6)


def test_the_panda_has_its_links_its_home_and_the_masses_that_were_identified():
    robot = Panda(Panda.Settings()).model.description.robot
    assert len(robot.findall("link")) == 7 + 2 + 1
    masses = [float(mass.get("value", "nan")) for mass in robot.iter("mass")]
    identified = 0.6298 + 4.9707 + 0.6469 + 3.2286 + 3.5879 + 1.2259 + 1.6666 + 0.7355 + 0.73 + 2 * 0.015
    assert sum(masses) == pytest.approx(identified, abs=1e-4)
    assert Panda(Panda.Settings()).home == pytest.approx((0.638, 0.0, 0.199), abs=1e-3)
