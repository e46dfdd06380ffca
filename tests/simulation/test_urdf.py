import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.fourth_robot import exported_arm, small_arm

from karolos.errors import PluginError
from karolos.plugins.contracts import Candidate, candidate
from karolos.plugins.contracts.joined import joined
from karolos.robots.panda import Panda
from karolos.simulation import urdf
from karolos.simulation.bullet.world import BulletWorld
from karolos.simulation.parts import Mechanism
from karolos.system.files import find_named

LIMIT = '<limit lower="0" upper="1" effort="1" velocity="1"/>'
BODY = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
BALL = '<geometry><sphere radius="1"/></geometry>'
COLOUR = '<material name="red"><color rgba="1 0 0 1 1"/></material>'
A, B = '<link name="a"/>', f'<link name="b">{BODY}</link>'
MESH = '<visual><geometry><mesh filename="package://x/arm.stl"/></geometry></visual></link>'
angles = st.floats(-3.1, 3.1)


@given(angles, st.floats(-1.5, 1.5), angles)
def test_roll_pitch_yaw_is_the_inverse_of_the_rotation_matrix(roll, pitch, yaw):
    rotation = urdf.rotation_matrix(roll, pitch, yaw)
    np.testing.assert_allclose(urdf.rotation_matrix(*urdf.roll_pitch_yaw(rotation)), rotation, atol=1e-9)


@pytest.mark.parametrize("pitch", [-np.pi / 2, np.pi / 2])
def test_roll_pitch_yaw_holds_at_the_poles(pitch):
    rotation = urdf.rotation_matrix(0.4, pitch, 0.9)
    np.testing.assert_allclose(urdf.rotation_matrix(*urdf.roll_pitch_yaw(rotation)), rotation, atol=1e-7)


WHOLE = Panda(Panda.Settings()).model.description.robot
FINGERS = {"franka_hand/finger_joint1": 0.0, "franka_hand/finger_joint2": 0.0}


def test_welding_removes_links_and_keeps_mass_and_shapes():
    whole = WHOLE
    welded = urdf.weld(whole, FINGERS)

    def masses(robot: urdf.Element) -> float:
        return sum(float(mass.get("value", "nan")) for mass in robot.iter("mass"))

    assert len(welded.findall("link")) == len(whole.findall("link")) - 2
    assert masses(welded) == pytest.approx(masses(whole))
    for shape in ("visual", "collision"):
        assert len(list(welded.iter(shape))) == len(list(whole.iter(shape)))
    assert len(whole.findall("joint")) == 9, "the original must not change"


def test_welded_robot_weighs_as_much_on_its_joints_as_the_whole_one():
    """Gravity torques of both, computed by PyBullet, at a pose that bends every joint."""
    pytest.importorskip("pybullet")
    world = BulletWorld()
    pose = [0.3, 0.5, -0.2, -1.5, 0.4, 2.0, 0.9]
    whole = world.load(Mechanism(WHOLE))
    welded = world.load(Mechanism(urdf.weld(WHOLE, FINGERS)))

    def torques(index: int, fingers: int) -> list[float]:
        nothing = [0.0] * (7 + fingers)
        return list(world.api.calculateInverseDynamics(index, pose + [0.0] * fingers, nothing, nothing)[:7])

    np.testing.assert_allclose(torques(welded.index, 0), torques(whole.index, 2), atol=1e-4)
    world.close()


def test_missing_urdf_is_a_clear_error(tmp_path):
    with pytest.raises(PluginError, match=r"/robot\.urdf: cannot be read \(No such file or directory\)"):
        urdf.load(tmp_path / "robot.urdf")


def robot(*parts: str) -> str:
    return f"<robot>{''.join(parts)}</robot>"


def turning(name: str, parent: str, child: str, more: str = LIMIT) -> str:
    return f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>{more}</joint>'


def test_the_base_of_a_mobile_robot_stands_still_and_a_wrong_colour_is_left_out(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(robot(A, '<link name="b"/>', turning("j", "a", "b").replace("revolute", "planar"), COLOUR))
    found = urdf.load(path)
    assert (found.stopped, found.joints, found.robot.find("material/color")) == (("j",), (), None)


J = turning("j", "a", "b")
LIMITS = r"urdf:1: joint j: limits must satisfy lower < upper, effort > 0, velocity > 0; .* exporters leave zeros"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot", "not an XML file"),
        ('<!DOCTYPE r [\n<!ENTITY e "x">]><robot/>', "urdf:2: it declares the entity 'e'"),
        ("<house/>", "not a URDF"),
        ('<robot xmlns:x="http://www.ros.org/wiki/xacro"><x:macro/></robot>', "not expanded; `karolos robot check"),
        ('<robot xmlns:x="http://wiki.ros.org/xacro"><x:macro/></robot>', "not expanded; `karolos robot check"),
        (robot(A, '<joint name="j" type="screw"/>'), "joint j: a screw joint"),
        (robot(A, '<joint name="j" type="revolute"/>'), "joint j: a joint without parent or child"),
        (robot(A, J), "joint j: there is no link 'b'"),
        (robot(A, A), "link a: two of this name"),
        (robot(A, B), "2 links without a joint above them: a, b; exactly one link is the base"),
        (robot(A, B, J, turning("k", "a", "b")), "joint k: link 'b' is also the child of joint j"),
        (robot('<link name="c"/>', A, B, J, turning("k", "b", "a")), "joint j: not connected to the base"),
        (robot(A, B, turning("j", "a", "b", "")), LIMITS),
        (robot(A, B, J.replace('lower="0"', 'lower="2"')), LIMITS),
        (robot(A, B, J.replace('effort="1"', 'effort="0"')), LIMITS),
        (robot(A, B, J.replace("velocity", "v")), LIMITS),
        (robot(A, B, J.replace('upper="1"', 'upper="much"')), "joint j: <limit>: its upper is 'much'; 1 number from"),
        (robot(A, B, turning("j", "a", "b", f'{LIMIT}<axis xyz="0 0 0"/>')), "joint j: its axis is 0 0 0"),
        (robot(A, '<link name="b"/>', J), "link b: it moves and has no mass"),
        (robot(A, B.replace('ixx="1"', 'ixx="-1"'), J), "link b: its inertia is not positive definite"),
        (robot(A, B.replace("</link>", MESH), J), "link b: there is no mesh 'package://x/arm.stl'; it is looked for"),
    ],
)
def test_a_urdf_that_cannot_be_simulated_is_refused_in_one_line_that_names_the_joint_or_link(tmp_path, text, message):
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    with pytest.raises(PluginError, match=message) as caught:
        urdf.load(path)
    assert "\n" not in str(caught.value)


def test_a_robot_as_exporters_write_it_moves_as_the_plain_one(tmp_path):
    """Transmissions, a world link, fixed joints between those of the arm, a mirrored finger, a continuous joint."""
    plain = Candidate("robots", "plain", small_arm(tmp_path))
    dressed = Candidate("robots", "dressed", exported_arm(tmp_path))
    draws = np.random.default_rng(0)
    with (
        joined(plain, candidate("tasks", "pick_place")) as one,
        joined(dressed, candidate("tasks", "pick_place")) as other,
    ):
        assert other.reset(0).observation == pytest.approx(one.reset(0).observation, abs=1e-5)
        for _ in range(20):
            action = draws.uniform(-1, 1, one.signature.action.size)
            assert other.step(action).observation == pytest.approx(one.step(action).observation, abs=1e-3)
        assert other.robot.opening == pytest.approx(one.robot.opening, abs=1e-3)


def test_a_mesh_is_found_beside_the_urdf_and_by_its_package_wherever_the_urdf_stands(tmp_path):
    urdfs, meshes = tmp_path / "my_robot" / "urdf", tmp_path / "my_robot" / "meshes"
    urdfs.mkdir(parents=True)
    meshes.mkdir()
    mesh = meshes / "arm.stl"
    mesh.touch()
    for name in ("../meshes/arm.stl", "meshes/arm.stl", "package://my_robot/meshes/arm.stl", f"file://{mesh}"):
        assert find_named(name, urdfs) == mesh, name
    renamed = (tmp_path / "my_robot").rename(tmp_path / "robot-main")
    assert find_named("package://my_robot/meshes/arm.stl", renamed / "urdf") == renamed / "meshes" / "arm.stl"


def test_an_inertia_that_no_body_can_have_is_corrected_as_little_as_possible(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(robot(A, B.replace('izz="1"', 'izz="3"'), J))
    found = urdf.load(path)
    assert found.corrected == ("b",)
    inertia = found.robot.findall("link/inertial/inertia")[1]
    assert [float(inertia.get(key, "0")) for key in ("ixx", "iyy", "izz")] == pytest.approx([1.5, 1.5, 3], abs=0.01)


def test_dry_friction_takes_torque_from_its_motor(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(robot(A, B, turning("j", "a", "b", f'{LIMIT}<dynamics damping="2" friction=".25"/>')))
    assert urdf.load(path).joints[0].effort == 0.75


def test_a_locked_joint_takes_along_those_that_mimic_it(tmp_path):
    path = tmp_path / "robot.urdf"
    mimic = f'{LIMIT}<origin xyz="0 0 1"/><mimic joint="j" multiplier="-1" offset="0.5"/>'  # held at 0
    links = f'{A}{B}<link name="c">{BODY}<collision><origin xyz="0 1 0"/>{BALL}</collision></link>'
    path.write_text(robot(links, J, turning("k", "b", "c", mimic)))
    found = urdf.load(path, (("j", 0.5),))
    assert not found.joints
    assert found.carriers == {"a": "a", "b": "a", "c": "a"}
    origin = found.robot.findall("link/collision/origin")[0]
    assert [float(one) for one in origin.get("xyz", "").split()] == pytest.approx(
        [0, np.cos(0.5) - np.sin(0.5), np.cos(0.5) + np.sin(0.5)]
    )
    with pytest.raises(PluginError, match="no joint is called 'x'; joints: j, k"):
        urdf.load(path, (("x", 0.5),))
