"""Meshes of strangers: STL and OBJ, read and checked here, so that an engine reads only what karolos wrote.

Engines collide convex shapes: a mesh is its convex hull, or is decomposed into convex pieces.
PyBullet reads past the end of its arrays where a face names a missing corner, and takes minutes for blank lines.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
import tempfile
import warnings
from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core import Array
from ..errors import MachineError, PluginError
from ..files import writing

Collision = Literal["convex", "decomposed"]
"""What a mesh that is not convex collides as: its convex hull, or convex pieces of it."""
MESH_SUFFIXES = (".stl", ".obj")
LARGEST_MESH = 20_000_000
"""Largest size of a file in bytes."""
LARGEST_NUMBER = 1e5
"""Largest coordinate, and largest number of a URDF, in its unit."""
LARGEST_PART, LEAST_PART = 5.0, 1e-4
"""m: the longest edge of the box around a part, in its scale. Beyond, its unit is wrong."""
SAME_VOLUME = 0.95
"""A mesh that fills less of its convex hull is not convex."""
LEAST_SHARE = 1e-3
"""A closed mesh that fills less of its convex hull encloses nothing: its sides cancel each other."""
CONCAVITY = 0.02
"""Largest concavity of a convex piece, as CoACD measures it, in parts of the mesh's size."""
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])


@cache
def triangles(path: Path) -> NDArray[np.float32]:
    """Corners (n, 3, 3) of a mesh, in its own frame and unit. The result is shared and must not be changed.

    Raises PluginError for a file that is too large, damaged, empty, or has numbers that are not finite.
    """
    try:
        if path.stat().st_size > LARGEST_MESH:
            raise PluginError(f"larger than {LARGEST_MESH / 1e6:g} MB", where=str(path), hint="simplify the mesh")
        data = path.read_bytes()
    except OSError as error:
        raise PluginError(f"cannot be read: {error.strerror}", where=str(path)) from None
    with np.errstate(over="ignore"):  # infinite, and refused below
        found = _obj(data, path) if path.suffix.lower() == ".obj" else _stl(data, path)
    if not (len(found) and np.abs(found).max() <= LARGEST_NUMBER):  # NaN is not
        raise PluginError(f"no triangles, or a coordinate beyond {LARGEST_NUMBER:g}", where=str(path))
    return found


def stl(corners: NDArray[np.floating[Any]]) -> bytes:
    """Triangles (n, 3, 3) as binary STL."""
    made = np.zeros(len(corners), _TRIANGLE)
    made["corners"] = corners
    made["normal"] = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    made["normal"] /= np.maximum(np.linalg.norm(made["normal"], axis=1, keepdims=True), 1e-30)
    return bytes(80) + len(made).to_bytes(4, "little") + made.tobytes()


class Solid(NamedTuple):
    """What a mesh encloses, or its convex hull where it is not closed; in its own frame and unit."""

    volume: float
    centre: Array
    """Centre of mass (3,)."""
    tensor: Array
    """Inertia (3, 3) about the centre, per mass."""
    filled: str
    """What its convex hull fills, in words; empty for a convex mesh."""


@cache
def solid(path: Path) -> Solid:
    """Volume and inertia of a mesh. Raises PluginError as `triangles`, and for one that is flat."""
    from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415 (takes .1 s)

    corners, faces = np.unique(triangles(path).reshape(-1, 3), axis=0, return_inverse=True)
    faces = faces.reshape(-1, 3)
    try:
        hull = ConvexHull(corners.astype(float))
    except QhullError:
        raise PluginError("flat: its corners are in one plane", where=str(path)) from None
    holes = _holes(faces)
    if holes is None or abs(_volumes(corners, faces).sum()) < LEAST_SHARE * hull.volume:
        return Solid(*_moments(corners, hull.simplices, convex=True), "an open surface")
    volume, centre, tensor = _moments(corners, faces, convex=False)
    filled = ""
    if holes:
        filled = "a hole" if holes == 1 else f"{holes} holes"
    elif volume < SAME_VOLUME * hull.volume:
        filled = f"a hollow: {1 - volume / hull.volume:.0%} of it"
    return Solid(volume, centre, tensor, filled)


def _volumes(corners: NDArray[np.float32], faces: NDArray[np.intp]) -> Array:
    """Volumes (n,) of the tetrahedra from the mean corner to each triangle; negative behind one."""
    volumes: Array = np.linalg.det(corners[faces] - corners.mean(0).astype(float)) / 6
    return volumes


def _holes(faces: NDArray[np.intp]) -> int | None:
    """Number of holes through a mesh of triangles (n, 3) of corners; None for one that is not closed."""
    from scipy.sparse import coo_array  # noqa: PLC0415
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges, counts = np.unique(edges[edges[:, 0] != edges[:, 1]], axis=0, return_counts=True)
    if not len(edges) or counts.max() > 1 or len(np.unique(np.vstack([edges, edges[:, ::-1]]), axis=0)) > len(edges):
        return None  # an edge without a triangle on its other side
    size = int(faces.max()) + 1
    parts, _ = connected_components(coo_array((np.ones(len(edges)), edges.T), (size, size)), directed=False)
    return int(parts) - (size - len(edges) // 2 + len(edges) // 3) // 2  # Euler: V - E + F = 2 (parts - holes)


def _moments(corners: NDArray[np.float32], faces: NDArray[np.intp], *, convex: bool) -> tuple[float, Array, Array]:
    """Volume, centre and inertia per mass of what triangles enclose: sums over tetrahedra from one point.

    Triangles of a hull may face either way: the point is inside, and each tetrahedron counts.
    """
    middle = corners.mean(0).astype(float)
    tetrahedra, volumes = corners[faces] - middle, _volumes(corners, faces)
    volumes = np.abs(volumes) if convex else volumes
    volume = float(volumes.sum())
    sums = tetrahedra.sum(1)
    centre = volumes @ sums / (4 * volume)
    squares = np.einsum("n,ni,nj->ij", volumes, sums, sums) + np.einsum(
        "n,nki,nkj->ij", volumes, tetrahedra, tetrahedra
    )
    second = squares / (20 * volume) - np.outer(centre, centre)
    return abs(volume), middle + centre, np.trace(second) * np.eye(3) - second


def warn_of_hull(path: Path) -> None:
    """Say that a mesh collides as its convex hull where that is not the same."""
    if filled := solid(path).filled:
        hint = "collision='decomposed' keeps it, collision='convex' accepts it"
        warnings.warn(f"{path}: its convex hull, which collides, fills {filled}; {hint}", stacklevel=4)


def check_size(path: Path, scale: float | Sequence[float]) -> None:
    """Refuse a mesh whose size in m shows that its unit is another. Raises PluginError."""
    size = float((np.ptp(triangles(path).reshape(-1, 3), axis=0) * np.abs(scale)).max())
    if not LEAST_PART <= size <= LARGEST_PART:
        hint = "in millimetres? set scale: 0.001" if size > LARGEST_PART else "is it in metres already?"
        raise PluginError(f"a part of {size:.3g} m", where=str(path), hint=hint)


def pieces(path: Path) -> tuple[Path, ...]:
    """Files of the convex pieces that a mesh is decomposed into; the mesh itself where it is convex.

    They are kept by their content in the user's cache (`$XDG_CACHE_HOME/karolos`). Raises MachineError where the
    package coacd is missing, or the cache cannot be written.
    """
    if solid(path).filled == "":
        return (path,)
    key = hashlib.sha256(f"{CONCAVITY}".encode() + triangles(path).tobytes()).hexdigest()[:24]
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "karolos", "convex", key)
    if not folder.is_dir():
        with writing(folder.parent):
            folder.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=folder.parent) as made:
                found = _decompose(path)
                for number, piece in enumerate(found):
                    Path(made, f"{number:03d}.stl").write_bytes(stl(piece))
                if not folder.is_dir():  # another process may have been faster
                    os.rename(made, folder)
                    os.mkdir(made)
        sys.stderr.write(f"{path.name}: {len(found)} convex pieces, kept in {folder}\n")
    return tuple(sorted(folder.glob("*.stl")))


def _decompose(path: Path) -> list[NDArray[np.float32]]:
    try:
        import coacd  # noqa: PLC0415 (an extra)
    except ImportError:
        hint = "pip install 'karolos[parts]', or collide as the convex hull"
        raise MachineError(
            "the package coacd, which decomposes meshes, is missing", where=str(path), hint=hint
        ) from None
    coacd.set_log_level("error")
    corners, faces = np.unique(triangles(path).reshape(-1, 3), axis=0, return_inverse=True)
    found = coacd.run_coacd(coacd.Mesh(corners.astype(float), faces.reshape(-1, 3)), threshold=CONCAVITY)
    return [corners[faces].astype(np.float32) for corners, faces in found]


def _stl(data: bytes, path: Path) -> NDArray[np.float32]:
    count = int.from_bytes(data[80:84], "little")
    if len(data) == 84 + _TRIANGLE.itemsize * count:
        return np.frombuffer(data, _TRIANGLE, count, 84)["corners"]
    numbers = re.findall(rb"^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)\s*$", data, re.MULTILINE)
    try:
        return np.array(numbers, np.float32).reshape(-1, 3, 3)
    except ValueError:
        raise PluginError("not an STL file, or a damaged one", where=str(path)) from None


def _obj(data: bytes, path: Path) -> NDArray[np.float32]:
    corners: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for number, line in enumerate(data.splitlines(), 1):
        word, *rest = line.split() or [b""]
        try:
            if word == b"v":
                x, y, z = map(float, rest[:3])
                corners.append([x, y, z])
            elif word == b"f":
                indices = [int(one.partition(b"/")[0]) for one in rest]
                if len(indices) < 3 or not all(0 < abs(index) <= len(corners) for index in indices):
                    raise ValueError
                first, *others = (index - 1 if index > 0 else len(corners) + index for index in indices)
                faces += [(first, one, other) for one, other in pairwise(others)]
        except ValueError:
            what = "a corner of three numbers" if word == b"v" else f"a face of corners from 1 to {len(corners)}"
            raise PluginError(f"not {what}", where=f"{path}:{number}") from None
    return np.take(np.array(corners, np.float32).reshape(-1, 3), np.array(faces, int).reshape(-1, 3), axis=0)
