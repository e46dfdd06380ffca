from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from karolos.errors import PluginError
from karolos.robots.panda import Panda
from karolos.simulation import urdf
from karolos.simulation.bullet.world import World

PANDA = Panda.model.urdf
angles = st.floats(-3.1, 3.1)


@given(angles, st.floats(-1.5, 1.5), angles)
def test_roll_pitch_yaw_is_the_inverse_of_the_rotation_matrix(roll: float, pitch: float, yaw: float) -> None:
    rotation = urdf.rotation_matrix(roll, pitch, yaw)
    np.testing.assert_allclose(urdf.rotation_matrix(*urdf.roll_pitch_yaw(rotation)), rotation, atol=1e-9)


@pytest.mark.parametrize("pitch", [-np.pi / 2, np.pi / 2])
def test_roll_pitch_yaw_holds_at_the_poles(pitch: float) -> None:
    rotation = urdf.rotation_matrix(0.4, pitch, 0.9)
    np.testing.assert_allclose(urdf.rotation_matrix(*urdf.roll_pitch_yaw(rotation)), rotation, atol=1e-7)


def test_welding_removes_links_and_keeps_mass_and_shapes() -> None:
    whole = urdf.read(PANDA)
    welded = urdf.weld(whole, {"finger_joint1": 0.0, "finger_joint2": 0.0})

    def masses(robot: urdf.Element) -> float:
        return sum(float(mass.get("value", "nan")) for mass in robot.iter("mass"))

    assert len(welded.findall("link")) == len(whole.findall("link")) - 2
    assert masses(welded) == pytest.approx(masses(whole))
    for shape in ("visual", "collision"):
        assert len(list(welded.iter(shape))) == len(list(whole.iter(shape)))
    assert len(whole.findall("joint")) == 9, "the original must not change"


def test_welded_robot_weighs_as_much_on_its_joints_as_the_whole_one() -> None:
    """Gravity torques of both, computed by the physics engine, at a pose that bends every joint."""
    world = World()
    pose = [0.3, 0.5, -0.2, -1.5, 0.4, 2.0, 0.9]
    whole = world.load(urdf.read(PANDA))
    welded = world.load(urdf.weld(urdf.read(PANDA), {"finger_joint1": 0.0, "finger_joint2": 0.0}))

    def torques(index: int, fingers: int) -> list[float]:
        nothing = [0.0] * (7 + fingers)
        found = world.api.calculateInverseDynamics(
            index, pose + [0.0] * fingers, nothing, nothing, physicsClientId=world.client
        )
        return list(found[:7])

    np.testing.assert_allclose(torques(welded.index, 0), torques(whole.index, 2), atol=1e-4)
    world.close()


def test_missing_urdf_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match=r"cannot read robot\.urdf"):
        urdf.joints(tmp_path / "robot.urdf")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot", "not an XML file"),
        ("<house/>", "not a URDF"),
        ('<robot><link name="a"/><joint name="j" type="floating"/></robot>', "joint j: a floating joint"),
        ('<robot><link name="a"/><joint name="j" type="revolute"/></robot>', "without parent, child or limit"),
        (
            '<robot><link name="a"/><joint name="j" type="revolute"><parent link="a"/><child link="b"/>'
            '<limit lower="1" upper="0" effort="1" velocity="1"/></joint></robot>',
            "lower < upper",
        ),
        (
            '<robot><link name="a"/><joint name="j" type="revolute"><parent link="a"/><child link="b"/>'
            '<limit lower="0" upper="1" effort="1"/></joint></robot>',
            "not readable",
        ),
    ],
)
def test_broken_urdf_is_a_clear_error(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    with pytest.raises(PluginError, match=message):
        urdf.joints(path)


def test_urdf_that_the_engine_refuses_is_a_clear_error() -> None:
    world = World()
    robot = urdf.read(PANDA)
    for joint in robot.findall("joint"):
        child = joint.find("child")
        assert child is not None
        child.set("link", "nowhere")
    with pytest.raises(PluginError, match="cannot load"):
        world.load(robot)
    world.close()
