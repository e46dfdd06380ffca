from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from support.closing import opened
from support.fourth_robot import exported_arm, small_arm

from karolos.errors import PluginError
from karolos.plugins.contracts import Candidate, candidate
from karolos.plugins.contracts.joined import join
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
@example(0.4, -np.pi / 2, 0.9)
@example(0.4, np.pi / 2, 0.9)
def test_roll_pitch_yaw_is_the_inverse_of_the_rotation_matrix(roll, pitch, yaw):
    rotation = urdf.rotation_matrix(roll, pitch, yaw)
    np.testing.assert_allclose(urdf.rotation_matrix(*urdf.roll_pitch_yaw(rotation)), rotation, atol=1e-9)


def test_a_welded_robot_has_the_shapes_of_the_whole_one_and_weighs_as_much_on_its_joints():
    """Gravity torques of both, computed by PyBullet, at a pose that bends every joint."""
    pytest.importorskip("pybullet")
    whole = Panda(Panda.Settings()).model.description.robot
    welded = urdf.weld(whole, {"franka_hand/finger_joint1": 0.0, "franka_hand/finger_joint2": 0.0})
    assert len(welded.findall("link")) == len(whole.findall("link")) - 2
    for shape in ("visual", "collision"):
        assert len(list(welded.iter(shape))) == len(list(whole.iter(shape)))
    assert len(whole.findall("joint")) == 9, "the original must not change"
    world, torques = opened(BulletWorld()), []
    for robot, fingers in ((whole, 2), (welded, 0)):
        pose = [0.3, 0.5, -0.2, -1.5, 0.4, 2.0, 0.9] + [0.0] * fingers
        still = [0.0] * len(pose)
        body = world.load(Mechanism(robot))
        torques.append(world.api.calculateInverseDynamics(body.index, pose, still, still)[:7])
    np.testing.assert_allclose(*torques, atol=1e-4)


def test_missing_urdf_is_a_clear_error(tmp_path):
    with pytest.raises(PluginError, match=r"/robot\.urdf: cannot be read \(No such file or directory\)"):
        urdf.load(tmp_path / "robot.urdf")


def robot(*parts: str) -> str:
    return f"<robot>{''.join(parts)}</robot>"


@pytest.fixture
def load(tmp_path: Path) -> Callable[..., urdf.Description]:
    """Loads a URDF with this text."""

    def load(text: str, locked: tuple[tuple[str, float], ...] = ()) -> urdf.Description:
        path = tmp_path / "robot.urdf"
        path.write_text(text)
        return urdf.load(path, locked)

    return load


def turning(name: str, parent: str, child: str, more: str = LIMIT) -> str:
    return f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>{more}</joint>'


def test_the_base_of_a_mobile_robot_stands_still_and_a_wrong_colour_is_left_out(load):
    found = load(robot(A, '<link name="b"/>', turning("j", "a", "b").replace("revolute", "planar"), COLOUR))
    assert (found.stopped, found.joints, found.robot.find("material/color")) == (("j",), (), None)


def test_a_file_with_a_namespace_of_its_own_and_without_what_the_format_adds_is_read(load, tmp_path):
    text = robot(A, B, turning("j", "a", "b", LIMIT.replace('lower="0" ', "")))
    [joint] = load(text.replace("<robot>", '<robot xmlns="http://drake.mit.edu">')).joints
    assert (joint.lower, joint.upper) == (0.0, 1.0)
    (tmp_path / "wheel.urdf").write_text(robot(A, B, turning("j", "a", "b", "").replace("revolute", "continuous")))
    [joint] = urdf.load(tmp_path / "wheel.urdf", driven=False).joints
    assert (joint.lower, joint.upper) == (-urdf.CONTINUOUS_RANGE, urdf.CONTINUOUS_RANGE)


J = turning("j", "a", "b")
LIMITS = r"urdf:1: joint j: limits must satisfy lower < upper, effort > 0, velocity > 0; .* exporters leave zeros"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot", r"urdf:1:1: not an XML file: unclosed token"),
        ('<!DOCTYPE r [\n<!ENTITY e "x">]><robot/>', "urdf:2: it declares the entity 'e'"),
        ("<house/>", "not a URDF"),
        ("<mujoco/>", r"not a URDF: .*; it is MJCF: call it robot\.xml"),
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
def test_a_urdf_that_cannot_be_simulated_is_refused_in_one_line_that_names_the_joint_or_link(load, text, message):
    with pytest.raises(PluginError, match=message) as caught:
        load(text)
    assert "\n" not in str(caught.value)


def test_a_robot_as_exporters_write_it_moves_as_the_plain_one(tmp_path):
    """Transmissions, a world link, fixed joints between those of the arm, a mirrored finger, a continuous joint."""
    arms = (Candidate("robots", "arm", plugin) for plugin in (small_arm(tmp_path), exported_arm(tmp_path)))
    one, other = (opened(join(arm, candidate("tasks", "pick_place"))) for arm in arms)
    assert other.reset(0).observation == pytest.approx(one.reset(0).observation, abs=1e-5)
    draws = np.random.default_rng(0)
    for _ in range(20):
        action = draws.uniform(-1, 1, one.signature.action.size)
        assert other.step(action).observation == pytest.approx(one.step(action).observation, abs=1e-3)
    assert other.robot.opening == pytest.approx(one.robot.opening, abs=1e-3)


@pytest.mark.parametrize(
    ("low", "high", "axis", "factor", "limit"),
    [
        (0, 0.04, 1, -1, 'lower="-.04" upper="0" effort="9" velocity="1"'),
        (0, 0.04, 1, -1, 'lower="0" upper=".04" effort="9" velocity="1"'),
        (-0.04, 0, 1, -1, 'lower="-.04" upper="0" effort="9" velocity="1"'),
        (-0.02, 0.02, 1, -1, 'lower="-.02" upper=".02" effort="9" velocity="1"'),
        (0, 0.04, 1, -1, 'lower="0" upper="0" effort="0" velocity="0"'),
        (0, 0.04, 1, -0.5, ""),
        (0, 0.04, -1, 1, ""),
        (0.01, 0.04, -1, 1, 'lower="0" upper="0" effort="0" velocity="0"'),
    ],
)
def test_a_finger_that_mimics_another_slides_against_it(low, high, axis, factor, limit, tmp_path):
    kind = 'type="prismatic"><parent link="a"/>'
    mimic = f'<mimic joint="g" multiplier="{factor}"/>' + (f"<limit {limit}/>" if limit else "")
    slides = (
        f'<joint name="{name}" {kind}<child link="{name}"/><origin xyz="0 {y} 0"/>{more}</joint>'
        for name, y, more in (
            ("g", 0.03, f'<axis xyz="0 1 0"/><limit lower="{low}" upper="{high}" effort="7" velocity=".5"/>'),
            ("f", -0.03, f'<axis xyz="0 {axis} 0"/>{mimic}'),
        )
    )
    (path := tmp_path / "hand.urdf").write_text(robot(A, *slides, *(B.replace('"b"', f'"{name}"') for name in "gf")))
    one, other = urdf.load(path, slides=("g", "f")).joints
    assert (other.lower, other.effort, other.velocity) == (0, *((9.0, 1.0) if 'effort="9"' in limit else (7.0, 0.5)))
    for share in (0.0, 0.3, 1.0):
        first, second = (joint.origin[1] + joint.axis[1] * share * joint.upper for joint in (one, other))
        assert second == pytest.approx(-0.03 + axis * factor * (first - 0.03)), "as the format says"


def test_a_mesh_is_found_beside_the_urdf_and_by_its_package_wherever_the_urdf_stands(tmp_path):
    urdfs, meshes = tmp_path / "my_robot" / "urdf", tmp_path / "my_robot" / "meshes"
    urdfs.mkdir(parents=True)
    meshes.mkdir()
    mesh = meshes / "arm.stl"
    mesh.touch()
    for name in ("../meshes/arm.stl", "meshes/arm.stl", "package://my_robot/meshes/arm.stl", f"file://{mesh}"):
        assert find_named(name, urdfs) == mesh, name
    other = mesh.rename(meshes / "my arm.stl")
    for name in (r"..\meshes\my arm.stl", "package://my_robot/meshes/my%20arm.stl", other.as_uri()):
        assert find_named(name, urdfs) == other, name
    other.rename(mesh)
    renamed = (tmp_path / "my_robot").rename(tmp_path / "robot-main")
    assert find_named("package://my_robot/meshes/arm.stl", renamed / "urdf") == renamed / "meshes" / "arm.stl"


def test_a_link_collides_as_it_is_drawn_if_nothing_else_is_fixed_to_it_that_collides(load, tmp_path):
    (tmp_path / "ball.dae").write_text("no Collada: it is not read where collision shapes can be drawn")
    drawn = f'<visual><origin xyz="0 0 1"/>{BALL}{COLOUR}</visual>'
    dae = '<visual><geometry><mesh filename="ball.dae"/></geometry></visual>'
    solid = f'<link name="c">{dae}{drawn}</link><link name="d"><collision>{BALL}</collision></link>'
    fixed = "".join(turning(ends, *ends, "").replace("revolute", "fixed") for ends in ("bc", "cd"))
    for more, kept in (("", ["0 0 1"]), (solid + fixed, ["0.0 0.0 0.0"])):
        found = load(robot(A, B.replace("</link>", f"{drawn}</link>"), J, more)).robot
        assert [one.get("xyz") for one in found.findall("link[@name='b']/collision/origin")] == kept
        assert found.find("link/collision/material") is None
    marker = f'<link name="c">{drawn}</link>' + turning("bc", "b", "c", "").replace("revolute", "fixed")
    assert load(robot(A, B, J, marker)).robot.find("link/collision") is None
    (tmp_path / "label.obj").write_text("v 0 0 0\nv .1 0 0\nv 0 .1 0\nf 1 2 3\n")
    label = '<visual><geometry><mesh filename="label.obj"/></geometry></visual>'
    assert len(load(robot(A, B.replace("</link>", f"{label}{drawn}</link>"), J)).robot.findall("link/collision")) == 1
    with pytest.raises(PluginError, match="cannot be read as Collada"):
        load(robot(A, B.replace("</link>", f"{dae}</link>"), J))


def test_an_inertia_that_no_body_can_have_is_corrected_as_little_as_possible(load):
    found = load(robot(A, B.replace('izz="1"', 'izz="3"'), J))
    assert found.corrected == ("b",)
    inertia = found.robot.findall("link/inertial/inertia")[1]
    assert [float(inertia.get(key, "0")) for key in ("ixx", "iyy", "izz")] == pytest.approx([1.5, 1.5, 3], abs=0.01)


def test_dry_friction_takes_torque_from_its_motor(load):
    dynamics = f'{LIMIT}<dynamics damping="2" friction=".25"/>'
    assert load(robot(A, B, turning("j", "a", "b", dynamics))).joints[0].effort == 0.75


def test_a_locked_joint_takes_along_those_that_mimic_it(load):
    mimic = f'{LIMIT}<origin xyz="0 0 1"/><mimic joint="j" multiplier="-1" offset="0.5"/>'  # held at 0
    links = f'{A}{B}<link name="c">{BODY}<collision><origin xyz="0 1 0"/>{BALL}</collision></link>'
    text = robot(links, J, turning("k", "b", "c", mimic))
    found = load(text, (("j", 0.5),))
    assert not found.joints
    assert found.carriers == {"a": "a", "b": "a", "c": "a"}
    x, y, z = urdf.origin_of(found.robot.findall("link/collision")[0])[0]
    assert (x, y, z) == pytest.approx((0, np.cos(0.5) - np.sin(0.5), np.cos(0.5) + np.sin(0.5)))
    with pytest.raises(PluginError, match="no joint is called 'x'; joints: j, k"):
        load(text, (("x", 0.5),))
