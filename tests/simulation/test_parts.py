"""Parts from files: mass and inertia, what they collide as, and fixtures with joints from URDF, MJCF and code."""

from __future__ import annotations

import re
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.prisms import L, block_with_hole, prism
from support.rig import ENGINES

from karolos.errors import MachineError, PluginError, UsageError
from karolos.simulation import fixtures, meshes
from karolos.simulation.engines import Engine, make_world
from karolos.simulation.geometry import matrix_of
from karolos.simulation.parts import Link, Mechanism, mechanism
from karolos.simulation.shapes import Cuboid, Inertia, Mesh, inertia_of, volume_of

RED = (1.0, 0.0, 0.0, 1.0)


@pytest.fixture
def corner(tmp_path: Path) -> Path:
    return prism(tmp_path / "corner.stl", L, 20.0)


def test_mass_and_inertia_of_a_mesh_are_those_of_what_it_encloses(corner: Path) -> None:
    legs = [
        Cuboid((0.06, 0.02, 0.02), position=(0.03, 0.01, 0.01)),
        Cuboid((0.02, 0.04, 0.02), position=(0.01, 0.04, 0.01)),
    ]
    mesh = [Mesh(corner, 0.001, collision="convex")]
    assert volume_of(mesh) == pytest.approx(volume_of(legs)) == pytest.approx(4e-5)
    one, other = inertia_of(mesh, 0.3), inertia_of(legs, 0.3)
    assert one.centre == pytest.approx(other.centre)
    assert one.moments == pytest.approx(other.moments)


@pytest.mark.parametrize(
    ("scale", "said"), [(1.0, "a part of 60 m; in millimetres"), (1e-6, "a part of 6e-05 m; is it")]
)
def test_a_part_in_the_wrong_unit_is_refused(corner: Path, scale: float, said: str) -> None:
    with pytest.raises(PluginError, match=said):
        Mesh(corner, scale)


def test_what_a_convex_hull_fills_is_said(tmp_path: Path, corner: Path) -> None:
    block = block_with_hole(tmp_path / "block.stl", 80.0, 21.0, 25.0)
    for path, filled in ((corner, r"fills a hollow: 29%"), (block, "fills a hole")):
        with pytest.warns(UserWarning, match=filled):
            Mesh(path, 0.001)
    box = prism(tmp_path / "box.stl", [(0, 0), (30, 0), (30, 20), (0, 20)], 10.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Mesh(box, 0.001)
        Mesh(corner, 0.001, collision="convex")


@pytest.mark.parametrize("engine", ENGINES)
def test_a_mesh_falls_and_rests_as_its_hull(engine: Engine, corner: Path) -> None:
    """The L lies on its two tips: the side that only its hull has."""
    world = make_world(engine)
    body = world.body([Mesh(corner, 0.001, collision="convex")], 0.2, RED)
    half, (z, w) = 0.5**0.5, (-np.sin(np.pi / 8), np.cos(np.pi / 8))  # 45 degrees about z, then 90 about y: tips down
    standing = (half * z, half * w, half * z, half * w)
    body.place((0.0, 0.0, 0.08), standing)
    for _ in range(36):
        world.step()
    position, turn = body.pose()
    assert position[2] == pytest.approx(0.08 * half, abs=1.5e-3)
    assert matrix_of(turn) @ [half, half, 0.0] == pytest.approx([0.0, 0.0, -1.0], abs=0.02)
    assert sum(world.forces(body).values()) == pytest.approx(0.2 * 9.81, rel=0.1)
    world.close()


def test_a_decomposed_mesh_keeps_its_hole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("coacd")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    path = block_with_hole(tmp_path / "block.stl", 80.0, 30.0, 25.0)
    for engine in ENGINES:
        world = make_world(engine)
        world.body([Mesh(path, 0.001, collision="decomposed")], 0.0, RED)
        peg = world.body([Cuboid((0.02, 0.02, 0.06))], 0.1, RED)
        peg.place((0.0, 0.0, 0.06))
        for _ in range(24):
            world.step()
        assert peg.pose()[0][2] == pytest.approx(0.03, abs=1e-3)
        world.close()
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
HANDLE = Cuboid((0.02, 0.15, 0.08))


def drawer(kind: str, folder: Path) -> Path | Mechanism:
    """The same drawer from a URDF, from MJCF and made in code."""
    path = folder / f"drawer.{kind}"
    path.write_text({"urdf": URDF, "xml": MJCF}.get(kind, ""))
    if kind != "code":
        return path
    how: dict[str, Any] = {"axis": (-1, 0, 0), "range": (0.0, 0.2), "friction": 2.0, "damping": 3.0}
    inertia = Inertia((0.0, 0.0, 0.0), (0.001, 0.001, 0.001))
    slide = Link(
        name="slide", parent="base", shapes=[HANDLE], mass=0.5, inertia=inertia, position=(-0.03, 0, 0.05), **how
    )
    return mechanism([Link(name="base", shapes=[Cuboid((0.02, 0.2, 0.2))]), slide])


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("kind", ["urdf", "xml", "code"])
def test_a_drawer_slides_by_its_friction_its_damping_and_what_drives_it(
    engine: Engine, kind: str, tmp_path: Path
) -> None:
    world = make_world(engine)
    body = world.load(drawer(kind, tmp_path))
    body.place(
        (0.5, 0.0, 0.2), (0.0, np.sin(0.2), 0.0, np.cos(0.2))
    )  # it leans: 1.9 N along the slide, less than friction
    body.place_joint("slide", 0.05)
    for _ in range(12):
        world.step()
    assert body.joint("slide") == pytest.approx((0.05, 0.0), abs=1e-3)
    body.drive_joint("slide", 0.0, 0.5)  # that is less friction
    body.set_joint_damping("slide", 30.0)
    for _ in range(24):
        world.step()
    pull = 0.5 * 9.81 * np.sin(0.4)
    assert body.joint("slide")[1] == pytest.approx(-(pull - 0.5) / 30, rel=0.05)
    body.drive_joint("slide", 0.2, 20.0)
    for _ in range(36):
        world.step()
    position, speed = body.joint("slide")
    assert position == pytest.approx(0.2, abs=1e-3), "its end"
    assert abs(speed) < 1e-3
    at = body.link(0).position
    assert at == pytest.approx(
        (0.5 - 0.23 * np.cos(0.4) + 0.05 * np.sin(0.4), 0, 0.2 + 0.23 * np.sin(0.4) + 0.05 * np.cos(0.4)), abs=2e-3
    )
    world.close()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (URDF.replace('lower="0" upper=".2"', 'lower="0"'), "joint slide: limits must satisfy lower < upper"),
        (URDF.replace("<dynamics", '<mimic joint="x"/><dynamics'), "joint slide: it mimics x, which only a motor does"),
        (MJCF.replace("<option", "<tendon/><option"), "xml:2: tendon: <tendon> in <mujoco> is not known to karolos"),
        (MJCF.replace('mass=".5"', 'mass="1e999"'), "xml:5: inertial: its mass is '1e999'"),
        (MJCF.replace("range=", "ref="), "xml:4: joint slide: ref is not known"),
        (MJCF.replace('size=".01 .075 .04"', 'size=".01"'), "xml:3: geom: type 'box' with 1 sizes"),
        (MJCF.replace("<joint", "<freejoint/><joint"), "<freejoint> in <body> is not known"),
    ],
)
def test_what_of_a_file_is_not_known_is_refused_with_its_line(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "drawer.xml"
    path.write_text(text)
    with pytest.raises(PluginError, match=re.escape(said)):
        fixtures.read(path)


def test_a_link_that_cannot_move_is_refused() -> None:
    with pytest.raises(UsageError, match="link lid cannot move; a parent before it"):
        mechanism(
            [Link(name="box", shapes=[]), Link(name="lid", shapes=[HANDLE], parent="bx", mass=1.0, range=(0.0, 1.0))]
        )


@pytest.mark.parametrize("engine", ENGINES)
def test_moments_that_are_set_are_about_the_axes_of_the_link(engine: Engine) -> None:
    """A wheel of (1, 2, 3) kg cm2, or twice that, which 3 N cm turn about one axis after the other."""
    world = make_world(engine, substeps=1)
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
    world.close()
