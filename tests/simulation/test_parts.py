"""Parts from files: their size, mass and inertia, what they collide as, and that they fall and rest as that."""

from __future__ import annotations

import re
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from support.prisms import L, block_with_hole, prism
from support.rig import ENGINES

from karolos.errors import MachineError, PluginError
from karolos.simulation import meshes
from karolos.simulation.engines import Engine, make_world
from karolos.simulation.geometry import matrix_of
from karolos.simulation.shapes import Cuboid, Mesh, inertia_of, volume_of

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


@pytest.mark.parametrize("engine", ENGINES)
def test_a_decomposed_mesh_keeps_its_hole(
    engine: Engine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("coacd")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    path = block_with_hole(tmp_path / "block.stl", 80.0, 30.0, 25.0)
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
