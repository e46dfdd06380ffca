"""Meshes of strangers: STL and OBJ, read and checked here, so that an engine reads only what karolos wrote.

PyBullet reads past the end of its arrays where a face names a missing corner, and takes minutes for blank lines.
"""

from __future__ import annotations

import re
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import PluginError

MESH_SUFFIXES = (".stl", ".obj")
LARGEST_MESH = 20_000_000
"""Largest size of a file in bytes."""
LARGEST_NUMBER = 1e5
"""Largest coordinate, and largest number of a URDF, in its unit."""
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


def stl(path: Path) -> bytes:
    """The mesh as binary STL. Materials and pictures that the file names are left out."""
    corners = triangles(path)
    made = np.zeros(len(corners), _TRIANGLE)
    made["corners"] = corners
    made["normal"] = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    made["normal"] /= np.maximum(np.linalg.norm(made["normal"], axis=1, keepdims=True), 1e-30)
    return bytes(80) + len(made).to_bytes(4, "little") + made.tobytes()


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
