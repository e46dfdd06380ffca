"""Parts from files: mass and inertia, what they collide as, and fixtures with joints from URDF, MJCF and code."""

import re
import sys
import warnings
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from support.prisms import L, block_with_hole, prism
from support.rig import ENGINES, run
from support.rig import world as empty

from karolos.errors import MachineError, PluginError, UsageError
from karolos.simulation import fixtures, meshes, urdf
from karolos.simulation.geometry import matrix_of, multiply, rotated, rotation_about
from karolos.simulation.parts import Link, Mechanism, body, mechanism
from karolos.simulation.shapes import Cuboid, Inertia, Mesh, inertia_of, volume_of

RED = (1.0, 0.0, 0.0, 1.0)


@pytest.fixture
def corner(tmp_path: Path) -> Path:
    return prism(tmp_path / "corner.stl", L, 20.0)


@pytest.mark.parametrize("scale", [0.001, (0.001, -0.001, 0.003)])
def test_mass_and_inertia_of_a_mesh_are_those_of_what_it_encloses(corner, scale):
    _, y, z = 1000 * np.broadcast_to(scale, 3)
    legs = [
        Cuboid((0.06, 0.02, 0.02 * z), position=(0.03, 0.01 * y, 0.01 * z)),
        Cuboid((0.02, 0.04, 0.02 * z), position=(0.01, 0.04 * y, 0.01 * z)),
    ]
    mesh = [Mesh(corner, scale, collision="convex")]
    assert volume_of(mesh) == pytest.approx(volume_of(legs)) == pytest.approx(4e-5 * z)
    one, other = inertia_of(mesh, 0.3), inertia_of(legs, 0.3)
    assert one.centre == pytest.approx(other.centre)
    assert one.moments == pytest.approx(other.moments)


@pytest.mark.parametrize(("scale", "said"), [(1.0, "60 m; in millimetres"), (1e-6, "6e-05 m; is it")])
def test_a_part_in_the_wrong_unit_is_refused(corner, scale, said):
    with pytest.raises(PluginError, match=f"a part of {said}"):
        Mesh(corner, scale)


def test_what_a_convex_hull_fills_is_said(tmp_path, corner):
    block = block_with_hole(tmp_path / "block.stl", 80.0, 21.0, 25.0)
    for path, filled in ((corner, r"fills a hollow: 29%"), (block, "fills a hole")):
        with pytest.warns(UserWarning, match=filled):
            Mesh(path, 0.001)
    box = prism(tmp_path / "box.stl", [(0, 0), (30, 0), (30, 20), (0, 20)], 10.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Mesh(box, 0.001)
        Mesh(corner, 0.001, collision="convex")


def box(*place: float, size: tuple[float, ...] = (10, 10, 10)) -> NDArray[np.float32]:
    """The triangles of a box."""
    made: NDArray[np.float32] = (trimesh.creation.box(size).triangles + np.array(place)).astype(np.float32)
    return made


ONE = box(0, 0, 0)
ROUNDED = np.float32(1e-6) * np.sin(np.arange(ONE.size)).reshape(ONE.shape)
BODIES = {
    "two that touch with all of a face": ([ONE, box(10, 0, 0)], 2000, 5, ""),
    "two that touch with a part of a face": ([ONE, box(8, 0, 0, size=(6, 6, 6))], 1216, 1.421, ""),
    "two that touch with an edge": ([ONE, box(10, 10, 0)], 2000, 5, ""),
    "inside out": ([ONE[:, ::-1]], 1000, 0, ""),
    "a triangle turned": ([ONE[:5], ONE[5:6, ::-1], ONE[6:]], 1000, 0, ""),
    "one of two inside out": ([ONE, box(30, 0, 0)[:, ::-1]], 2000, 15, ""),
    "a hollow": ([ONE, box(0, 0, 0, size=(6, 6, 6))[:, ::-1]], 784, 0, ""),
    "a triangle without an area": ([ONE, ONE[:1, [0, 0, 1]]], 1000, 0, ""),
    "corners that differ by rounding": ([ONE + ROUNDED], 1000, 0, ""),
    "one in another": ([ONE, box(0, 0, 0, size=(6, 6, 6))], 1000, 0, "overlap"),
    "one twice": ([ONE, ONE], 1000, 0, "overlap"),
    "two that overlap": ([ONE, box(1, 0, 0)], 1100, 0.5, "overlap"),
    "a cross": ([box(0, 0, 0, size=(100, 4, 4)), box(0, 0, 0, size=(4, 100, 4))], 21568, 0, "overlap"),
    "open": ([ONE[2:]], 1000, 0, "an open surface"),
}


@pytest.mark.parametrize(("parts", "volume", "centre", "flaw"), BODIES.values(), ids=BODIES)
def test_bodies_of_a_file_weigh_what_they_enclose_or_say_that_they_weigh_as_their_hull(
    parts, volume, centre, flaw, tmp_path
):
    (path := tmp_path / "part.stl").write_bytes(meshes.stl(np.concatenate(parts)))
    found = meshes.solid(path)
    assert found.volume == pytest.approx(volume, rel=1e-5)
    assert found.centre[0] == pytest.approx(centre, abs=1e-3)
    assert bool(found.flaw) == bool(flaw)
    if flaw:
        with pytest.warns(UserWarning, match=f"part.stl: .*{flaw}.*: its volume and inertia are those of its convex"):
            Mesh(path, 0.001, collision="decomposed")


STL = meshes.stl(ONE)
FACET = "facet normal 0 0 0\nouter loop\n" + 3 * "vertex {} {} {}\n" + "endloop\nendfacet\n"
FACETS = "".join(FACET.format(*one) for one in ONE.reshape(-1, 9).tolist())
TEXT = f"solid a vertex 1 2\n{FACETS}endsolid a vertex 1 2\n"
OBJ = "".join("v {} {} {}\n".format(*corner) for corner in ONE.reshape(-1, 3).tolist())
FACES = [f"f {n} {n + 1} {n + 2}\n" for n in range(1, 36, 3)]
DIALECTS: dict[str, tuple[str, bytes]] = {
    "in capitals": ("stl", TEXT.upper().encode()),
    "of Windows": ("stl", TEXT.replace("\n", "\r\n").encode()),
    "of old Macs": ("stl", TEXT.replace("\n", "\r").encode()),
    "of two bodies": ("stl", TEXT.replace("endfacet\n", "endfacet\nendsolid a\nsolid b\n", 1).encode()),
    "a line's end after it": ("stl", STL + b"\r\n"),
    "count never written": ("stl", STL[:80] + bytes(4) + STL[84:]),
    "count of a stream": ("stl", STL[:80] + b"\xff" * 4 + STL[84:]),
    "binary that begins like text": ("stl", b"solid" + STL[5:]),
    "OBJ with comments": ("obj", (OBJ + " # 1\n".join(FACES)).replace("\n #", " #").encode()),
    "OBJ in broken lines": ("obj", b"\xef\xbb\xbf" + (OBJ + "".join(FACES).replace("f ", "f \\\n")).encode()),
}


@pytest.mark.parametrize(("kind", "data"), DIALECTS.values(), ids=DIALECTS)
def test_a_mesh_is_read_in_every_dialect(kind, data, tmp_path):
    (path := tmp_path / f"part.{kind}").write_bytes(data)
    assert np.array_equal(meshes.triangles(path), ONE)


REFUSED: dict[str, tuple[str, bytes]] = {
    "its header counts 12 triangles, 11 follow": ("stl", STL[:-50]),
    "its header counts 12 triangles, 24 follow": ("stl", STL + STL[84:]),
    "not an STL file, or a damaged one: 23 bytes": ("stl", b"version https://git-lfs"),
    "part.stl:11: not a corner of three numbers": ("stl", TEXT.replace("vertex 5.0", "vertex 5,0", 1).encode()),
    "cut off, or damaged: 6 triangles, 18 corners": ("stl", TEXT[: len(TEXT) // 2].encode()),
    "a coordinate beyond 100000, or not a number": ("stl", TEXT.replace("5.0", "nan").encode()),
    "part.obj:37: not a face of corners from 1 to 36": ("obj", (OBJ + "f 0 1 2").encode()),
    "no triangles": ("obj", OBJ.encode()),
    "cannot be read as Collada: DaeMalformedError": ("dae", b"<COLLADA>"),
    "a document type, entities": ("dae", b'<!DOCTYPE a [<!ENTITY x SYSTEM "/etc/passwd">]><COLLADA>&x;</COLLADA>'),
}


@pytest.mark.parametrize(("said", "file"), REFUSED.items(), ids=REFUSED)
def test_a_damaged_mesh_is_refused_for_a_true_reason(said, file, tmp_path):
    (path := tmp_path / f"part.{file[0]}").write_bytes(file[1])
    with pytest.raises(PluginError, match=re.escape(said)):
        meshes.triangles(path)


@pytest.mark.parametrize(("up", "centre"), [("Z_UP", (1, 2, 3)), ("Y_UP", (1, -3, 2)), ("X_UP", (-2, -3, 1))])
def test_collada_is_read_in_its_unit_with_its_upper_axis(up, centre, tmp_path):
    made = trimesh.creation.box((20, 40, 60)).apply_translation((10, 20, 30))
    text = trimesh.exchange.dae.export_collada(made).decode().replace("Y_UP", up)
    (path := tmp_path / "part.dae").write_text(text.replace("</asset>", '<unit name="mm" meter="0.001"/></asset>'))
    assert meshes.solid(path).volume == pytest.approx(4.8e-5)
    assert meshes.solid(path).centre == pytest.approx(np.array(centre) / 100)


def test_a_file_that_is_edited_is_read_again(tmp_path):
    part, drawer = tmp_path / "part.stl", tmp_path / "drawer.urdf"
    for size in (1, 2):
        part.write_bytes(meshes.stl(size * ONE))
        drawer.write_text(URDF.replace('upper=".2"', f'upper="{size}"'))
        assert volume_of([Mesh(part, 0.1)]) == pytest.approx(size**3)
        assert urdf.load(drawer, driven=False).joints[0].upper == size


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("engine", ENGINES)
def test_a_mesh_falls_and_rests_as_its_hull(engine, side, corner):
    """The L, or its mirror image, lies on its two tips: the side that only its hull has."""
    world = empty(engine)
    body = world.body([Mesh(corner, (0.001, side * 0.001, 0.001), collision="convex")], 0.2, RED)
    half = 0.5**0.5
    # 45 degrees about z, then 90 about y: its tips are down
    standing = multiply(rotation_about((0.0, np.pi / 2, 0.0)), rotation_about((0.0, 0.0, -side * np.pi / 4)))
    body.place((0.0, 0.0, 0.08), standing)
    run(world, 36)
    position, turn = body.pose()
    assert position[2] == pytest.approx(0.08 * half, abs=1.5e-3)
    assert matrix_of(turn) @ [half, side * half, 0.0] == pytest.approx([0.0, 0.0, -1.0], abs=0.02)
    assert sum(world.forces(body).values()) == pytest.approx(0.2 * 9.81, rel=0.1)


def test_a_decomposed_mesh_keeps_its_hole(tmp_path, monkeypatch, capsys):
    pytest.importorskip("coacd")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    path = block_with_hole(tmp_path / "block.stl", 80.0, 30.0, 25.0)
    for engine in ENGINES:
        world = empty(engine)
        world.body([Mesh(path, 0.001, collision="decomposed")], 0.0, RED)
        peg = world.body([Cuboid((0.02, 0.02, 0.06))], 0.1, RED)
        peg.place((0.0, 0.0, 0.06))
        run(world, 24)
        assert peg.pose()[0][2] == pytest.approx(0.03, abs=1e-3)
    said = re.search(r"block.stl: (\d+) convex pieces, kept in", capsys.readouterr().err)
    assert said is not None
    monkeypatch.setitem(sys.modules, "coacd", None)
    assert len(Mesh(path, 0.001, collision="decomposed").pieces()) == int(said[1]), "kept by content"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "other"))
    with pytest.raises(MachineError, match=r"block.stl: the package coacd.* missing; pip install 'karolos\[parts\]'"):
        meshes.pieces(path)


URDF = """
<robot name="cabinet"><link name="housing"><collision><geometry><box size=".02 .2 .2"/></geometry></collision></link>
  <joint name="slide" type="prismatic"><parent link="housing"/><child link="drawer"/><origin xyz="-.03 0 .05"/>
    <axis xyz="-1 0 0"/><limit lower="0" upper=".2"/><dynamics friction="2" damping="3"/></joint>
  <link name="drawer"><inertial><mass value=".5"/>
    <inertia ixx=".001" iyy=".001" izz=".001" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size=".02 .15 .08"/></geometry></collision></link></robot>
"""
MJCF = """
<mujoco><option timestep=".01"/><worldbody><light/><body name="housing"><geom type="box" size=".01 .1 .1"/>
  <body name="drawer" pos="-.02 0 .05"><geom type="box" size=".01 .075 .04" pos="-.01 0 0"/>
    <joint name="slide" type="slide" axis="-1 0 0" pos="-.01 0 0" range="0 .2" frictionloss="2" damping="3"/>
    <inertial pos="-.01 0 0" mass=".5" diaginertia=".001 .001 .001"/></body></body></worldbody></mujoco>
"""
FIXED = '<fixed><joint joint="slide" coef="1"/></fixed>'
MOTOR = '<motor joint="slide"/>'
HANDLE = Cuboid((0.02, 0.15, 0.08))


def drawer(kind: str, folder: Path) -> Path | Mechanism:
    """The same drawer from a URDF, from MJCF and made in code."""
    if kind != "code":
        path = folder / f"drawer.{kind}"
        path.write_text({"urdf": URDF, "xml": MJCF}[kind])
        return path
    slide = Link(
        name="slide",
        parent="base",
        shapes=[HANDLE],
        mass=0.5,
        inertia=Inertia((0.0, 0.0, 0.0), (0.001, 0.001, 0.001)),
        position=(-0.03, 0, 0.05),
        axis=(-1, 0, 0),
        range=(0.0, 0.2),
        friction=2.0,
        damping=3.0,
    )
    return mechanism([Link(name="base", shapes=[Cuboid((0.02, 0.2, 0.2))]), slide])


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("kind", ["urdf", "xml", "code"])
def test_a_drawer_slides_by_its_friction_its_damping_and_what_drives_it(engine, kind, tmp_path):
    world = empty(engine)
    body = world.load(drawer(kind, tmp_path))
    turn = rotation_about((0.0, 0.4, 0.0))  # it leans: 1.9 N along the slide, less than friction
    body.place((0.5, 0.0, 0.2), turn)
    body.place_joint("slide", 0.05)
    run(world, 12)
    assert body.joint("slide") == pytest.approx((0.05, 0.0), abs=1e-3)
    body.drive_joint("slide", 0.0, 0.5)  # that is less friction
    body.set_joint_damping("slide", 30.0)
    run(world, 24)
    pull = 0.5 * 9.81 * np.sin(0.4)
    assert body.joint("slide")[1] == pytest.approx(-(pull - 0.5) / 30, rel=0.05)
    body.drive_joint("slide", 0.2, 20.0)
    run(world, 36)
    position, speed = body.joint("slide")
    assert position == pytest.approx(0.2, abs=1e-3), "its end"
    assert abs(speed) < 1e-3
    assert body.link(0).position == pytest.approx(np.add((0.5, 0, 0.2), rotated(turn, (-0.23, 0, 0.05))), abs=2e-3)


CLASSES = """
<mujoco><compiler angle="radian"/><compiler angle="degree"/>
<default><geom density="500"/><default class="leaf"><geom type="capsule" size=".01" euler="5 0 0"/>
  <joint range="0 90" damping=".5"/><default class="pin"><geom type="cylinder" size=".02 .05" mass=".3"/></default>
  <default class="seen"><geom type="sphere" size=".03" contype="0" conaffinity="0"/></default></default></default>
<worldbody><body name="frame" euler="0 0 30"><geom type="box" size=".02 .02 .3"/>
  <body name="leaf" childclass="leaf" pos=".02 0 .05" euler="10 20 30"><joint name="h" pos="0 .01 0" axis="0 0 2"/>
    <geom fromto="0 0 0 .2 0 .1"/><geom class="pin" pos=".1 0 0" euler="0 40 0"/><geom class="seen" pos="0 0 .2"/>
    <geom type="box" size=".01 .02 .03" quat=".6 .8 0 0" density="2000"/>
    <body name="handle" pos=".2 0 0"><joint name="k" range="-45 45"/><geom class="pin" mass=".05"/></body>
</body></body></worldbody></mujoco>
"""


def test_masses_and_classes_of_mjcf_are_those_of_its_own_compiler(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    (path := tmp_path / "door.xml").write_text(CLASSES)
    model, found = mujoco.MjModel.from_xml_string(CLASSES), fixtures.read(path).robot
    for number, (name, joint) in enumerate(zip("hk", found.findall("joint"), strict=True)):
        link = next(one for one in found.findall("link") if one.get("name") == name)
        (mass, centre, tensor), body = urdf.inertia_of(link), model.jnt_bodyid[number]
        turn = matrix_of(tuple(model.body_iquat[body][[1, 2, 3, 0]]))
        assert mass == pytest.approx(model.body_mass[body], rel=1e-9)
        assert centre == pytest.approx(model.body_ipos[body] - model.jnt_pos[number], rel=1e-6, abs=1e-12)
        assert tensor == pytest.approx(turn @ np.diag(model.body_inertia[body]) @ turn.T, rel=1e-6, abs=1e-10)
        [limit], [dynamics] = joint.findall("limit"), joint.findall("dynamics")
        assert float(limit.get("upper", "")) == pytest.approx(model.jnt_range[number][1])
        assert dynamics.get("damping") == "0.5"


ARM = """
<mujoco><compiler angle="degree" eulerseq="zYx"/>
<default><default class="big"><joint range="-100 90"/><general forcerange="-87 87"/></default></default>
<worldbody><body name="b1" pos=".1 .2 .8" zaxis="1 1 1">
  <joint name="j1" class="big" axis="0 1 2" pos="0 .1 0" ref="20"/>
  <inertial pos="0 0 .1" mass="2" fullinertia=".02 .03 .025 .001 -.002 .003"/>
  <frame pos="0 0 .2" euler="10 20 30"><geom type="box" size=".1 .02 .02" mass="5"/>
    <body name="b2" xyaxes="0 1 0 -1 0 0.5"><joint name="j2" type="slide" ref=".03" range="-1 1" axis="1 1 0"/>
      <geom size=".03" pos=".1 0 0" density="500"/><geom type="capsule" size=".02" fromto="0 0 0 0 .2 0"/>
      <geom size=".05" contype="0" conaffinity="0" mass=".1"/>
      <body name="b3" pos="0 0 .3" axisangle="1 2 3 40"><joint name="j3" limited="false" range="0 1"/><geom size=".04"/>
      </body></body></frame></body></worldbody>
<actuator><general class="big" joint="j1"/><motor joint="j2" ctrlrange="-3 3" gear="4"/></actuator></mujoco>
"""


def test_an_arm_of_mjcf_is_where_its_own_compiler_has_it_and_weighs_as_much(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    (path := tmp_path / "arm.xml").write_text(ARM)
    model = mujoco.MjModel.from_xml_string(ARM)
    text = ElementTree.tostring(fixtures.arm(path, 2.0, 0.1), "unicode")
    found, data = urdf.load(path, strict=False, text=text), mujoco.MjData(model)
    assert [joint.name for joint in found.joints] == ["j1", "j2", "j3"], "the joint of the outermost body, too"
    data.qpos[:] = (0.3, -0.2, 0.5)
    mujoco.mj_kinematics(model, data)
    place, turn = np.zeros(3), np.eye(3)
    for number, (joint, position) in enumerate(zip(found.joints, data.qpos, strict=True)):
        place, turn = place + turn @ joint.origin, turn @ np.array(joint.rotation)
        assert turn @ joint.axis == pytest.approx(data.xaxis[number], abs=1e-9)
        if joint.revolute:
            assert place == pytest.approx(data.xanchor[number], abs=1e-9)
            turn = turn @ urdf.about(joint.axis, position)
        place = place + turn @ joint.axis * position * (not joint.revolute)
        link = next(one for one in found.robot.findall("link") if one.get("name") == joint.child)
        mass, centre, tensor = urdf.inertia_of(link)
        body = model.jnt_bodyid[number]
        there = data.ximat[body].reshape(3, 3)
        assert mass == pytest.approx(model.body_mass[body], rel=1e-9)
        assert place + turn @ centre == pytest.approx(data.xipos[body], abs=1e-9)
        moved = there @ np.diag(model.body_inertia[body]) @ there.T
        assert turn @ tensor @ turn.T == pytest.approx(moved, rel=1e-6, abs=1e-9)
    assert [joint.effort for joint in found.joints] == [87.0, 12.0, 0.0]
    assert [joint.velocity for joint in found.joints] == [2.0, 0.1, 2.0]
    assert (found.joints[0].lower, found.joints[2].upper) == pytest.approx((np.radians(-100), 2 * np.pi))


def test_a_mirrored_and_stretched_mesh_of_mjcf_is_where_mujoco_has_it(corner, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    mesh = f'<asset><mesh name="m" file="{corner}" scale=".001 -.002 .003"/></asset>'
    geom = '<geom type="mesh" mesh="m" pos=".1 .2 .3" euler="10 20 30"/>'
    (path := tmp_path / "arm.xml").write_text(
        f"<mujoco>{mesh}<worldbody><body name='b'>{geom}</body></worldbody></mujoco>"
    )
    model = mujoco.MjModel.from_xml_path(str(path))
    there = model.mesh_vert @ matrix_of(np.roll(model.geom_quat[0], -1)).T + model.geom_pos[0]
    [shape] = fixtures.arm(path, 2.0, 0.1).findall("link[@name='b']/collision")
    scale, place, angles = (
        np.array(shape.find(name).get(key).split(), float)
        for name, key in (("geometry/mesh", "scale"), ("origin", "xyz"), ("origin", "rpy"))
    )
    turn = urdf.rotation_matrix(*angles)
    found = (meshes.triangles(corner).reshape(-1, 3) * scale) @ turn.T + place
    assert np.unique(found.round(6), axis=0) == pytest.approx(np.unique(there.round(6), axis=0), abs=2e-6)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<frame pos", '<include file="b.xml"/><frame pos', "xml: include: MuJoCo refuses it: Error opening file"),
        ("<frame pos", '<model file="b.xml"/><frame pos', "xml:7: <model> is not known to karolos; mujoco writes"),
        ('type="slide" ref=".03" range="-1 1"', 'type="ball"', "xml:8: joint j2: a ball joint; joints of an arm are"),
        (
            'name="j3"',
            'name="j4"/><joint name="j3"',
            "xml:11: body b3: one body has 2 joints; a body of an arm has one",
        ),
        ('"zYx"', '"xy"', "xml:2: compiler: MuJoCo refuses it: attribute 'eulerseq' must have exactly 3 characters"),
        ("0 1 0 -1 0 0.5", "0 1 0 0 2 0", "xml:8: b2: MuJoCo refuses it: error 'yaxis too small'"),
        (ARM, "<mujoco><worldbody/></mujoco>", "no bodies in <worldbody>; an arm is a tree of bodies"),
    ],
)
def test_what_of_an_arm_in_mjcf_would_be_lost_is_refused(old, new, said, tmp_path):
    (path := tmp_path / "arm.xml").write_text(ARM.replace(old, new))
    with pytest.raises(PluginError, match=re.escape(said)):
        fixtures.arm(path, 2.0, 0.1)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            CLASSES.replace('class="pin" p', 'class="pen" p'),
            "xml:8: geom: MuJoCo refuses it: unknown default class name 'pen'",
        ),
        (URDF.replace('lower="0" upper=".2"', 'lower="0"'), "joint slide: limits must satisfy lower < upper"),
        (URDF.replace("<dynamics", '<mimic joint="x"/><dynamics'), "joint slide: it mimics x, which is possible only"),
        (MJCF.replace("</mujoco>", f"<tendon>{FIXED}</tendon></mujoco>"), "xml:5: tendon: a fixture has no tendons"),
        (MJCF.replace("</mujoco>", f"<actuator>{MOTOR}</actuator></mujoco>"), "actuator: a fixture has no actuators"),
        (
            MJCF.replace('mass=".5"', 'mass="1e999"'),
            "xml:5: inertial: MuJoCo refuses it: number is too large in attribute",
        ),
        (MJCF.replace("range=", 'stiffness="2" ref=".1" range='), "xml:4: joint slide: ref, stiffness is not known"),
        (
            MJCF.replace("range=", "limited='false' range="),
            "xml:3: body drawer: a moving body needs one joint, a hinge",
        ),
        (
            MJCF.replace('type="slide"', 'type="ball"').replace("range=", "user="),
            "body drawer: a moving body needs one",
        ),
        (MJCF.replace("<joint", '<joint axis="0 1 0"/><joint'), "xml:3: body drawer: a moving body needs one joint"),
        (MJCF.replace("<geom", "<joint/><geom", 1), "xml:2: body housing: the base of a fixture has no joint"),
        (MJCF.replace("<light/>", "<light/><body/>"), "several bodies in <worldbody>; it needs one, the base"),
        (MJCF.replace('type="box"', 'type="ellipsoid"'), "geom: its type is ellipsoid; known are box, sphere"),
        (
            MJCF.replace('size=".01 .075 .04"', 'size=".01"'),
            "xml:3: MuJoCo refuses it: size 1 must be positive in geom",
        ),
    ],
)
def test_what_of_a_file_is_not_known_is_refused_with_its_line(text, said, tmp_path):
    path = tmp_path / "drawer.xml"
    path.write_text(text)
    with pytest.raises(PluginError, match=re.escape(said)):
        fixtures.read(path)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"mass": float("nan")}, "body: a mass of nan kg"),
        ({"mass": -1.0}, "body: a mass of -1 kg; a number > 0, or 0"),
        ({"inertia": Inertia((0, 0, 0), (-1.0, 1.0, 1.0))}, "body: no body has the moments -1 1 1"),
        ({"inertia": Inertia((0, 0, 0), (1.0, 9.0, 1.0))}, "body: no body has the moments 1 1 9"),
    ],
)
def test_a_mass_and_moments_that_no_body_has_are_refused(given, said):
    with pytest.raises(UsageError, match=said):
        body([Cuboid((0.1, 0.1, 0.1))], **{"mass": 1.0, **given})
    with pytest.raises(UsageError, match="Cuboid: orientation"):
        Cuboid((0.1, 0.1, 0.1), orientation=(0.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("links", "said"),
    [
        ([], "a mechanism without links"),
        ([{"name": "lid"}, {"name": "lid"}], "two links are called lid"),
        ([{"name": "lid", "mass": -1.0}], "link lid: a mass of -1 kg"),
        ([{"name": "lid", "damping": -1.0}], "link lid cannot move; .* no negative friction"),
        ([{"name": "lid", "joint": "ball"}], "link lid cannot move; .* slide or hinge"),
    ],
)
def test_a_mechanism_that_no_engine_can_simulate_is_refused(links, said):
    usual: dict[str, Any] = {"shapes": [], "parent": "box", "mass": 1.0, "range": (0.0, 1.0)}
    with pytest.raises(UsageError, match=said):
        mechanism([Link(name="box", shapes=[]), *(Link(**usual | link) for link in links)] if links else [])


def test_a_link_that_cannot_move_is_refused():
    with pytest.raises(UsageError, match="link lid cannot move; a parent before it"):
        mechanism([Link(name="box", shapes=[]), Link(name="lid", shapes=[], parent="bx", mass=1.0, range=(0.0, 1.0))])


@pytest.mark.parametrize("engine", ENGINES)
def test_moments_that_are_set_are_about_the_axes_of_the_link(engine):
    """A wheel of (1, 2, 3) kg cm2, or twice that, which 3 N cm turn about one axis after the other."""
    world = empty(engine, substeps=1)
    own = Inertia((0.0, 0.0, 0.0), (1e-4, 2e-4, 3e-4))
    for place, axis in enumerate([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]):
        how: dict[str, Any] = {"parent": "base", "joint": "hinge", "range": (-9, 9), "axis": axis}
        wheel = Link(name="wheel", shapes=[], mass=0.1, inertia=own, **how)
        body = world.load(mechanism([Link(name="base", shapes=[]), wheel]), position=(place, 0.0, 1.0))
        for factor in (1, 2):
            moments = factor * 1e-4, factor * 2e-4, factor * 3e-4
            body.set_inertia(0.1, moments, body.links()["wheel"])
            body.place_joint("wheel", 0.0)
            body.drive_joint("wheel", 1000.0, 0.03)
            world.step()
            assert body.joint("wheel")[1] / world.period == pytest.approx(0.03 / moments[place], rel=0.02)
            body.drive_joint("wheel", 0.0, 0.0)
