"""Reads and checks foreign meshes (STL, OBJ, Collada), so that an engine reads only files that karolos wrote.

Engines collide convex shapes: a mesh is its convex hull, or is decomposed into convex pieces.
PyBullet reads past the end of its arrays if a face names a missing corner, and takes minutes for blank lines. Trimesh
reads Collada and analyses how triangles are connected. OBJ and STL are read here: trimesh misreads a corner 0, a
relative corner or a missing number of an OBJ without an error, and finds nothing in an STL with a wrong count.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
import tempfile
import warnings
from codecs import BOM_UTF8
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core import Array
from ..errors import MachineError, PluginError
from ..system.files import user_cache, writing

Collision = Literal["convex", "decomposed"]
"""Collision shape of a mesh that is not convex: its convex hull, or convex pieces of it."""
MESH_SUFFIXES = (".stl", ".obj", ".dae")
LARGEST_MESH = 20_000_000
"""Largest size of a file in bytes."""
LARGEST_NUMBER = 1e5
"""Largest coordinate, and largest number of a URDF, in its unit."""
LARGEST_PART, LEAST_PART = 5.0, 1e-4
"""Range in m of the longest edge of the box around a scaled part. Outside it the unit is wrong."""
SAME_VOLUME = 0.95
"""Share of its convex hull that a convex mesh fills at least."""
LEAST_SHARE = 1e-3
"""A closed mesh that fills a smaller share of its convex hull encloses nothing: its sides cancel each other."""
LINES, MOST_TESTS = 200, 4_000_000
"""Number of lines per axis that test how often a mesh encloses a place, and largest number of line-triangle pairs."""
TWICE = 0.005
"""Share of a mesh that may be enclosed twice or from behind. The error of its mass is at most this share."""
ROUNDING = 1e-6
"""Corners nearer than this share of the mesh's size are merged, if the surface is open otherwise."""
CONCAVITY = 0.02
"""Largest concavity of a convex piece, as CoACD measures it, relative to the mesh's size."""
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])


def _content(path: Path) -> bytes:
    """The bytes of a file. Results are cached by them, so an edited file is read again."""
    try:
        if path.stat().st_size > LARGEST_MESH:
            raise PluginError(f"larger than {LARGEST_MESH / 1e6:g} MB", where=str(path), hint="simplify the mesh")
        return path.read_bytes()
    except OSError as error:
        raise PluginError(f"cannot be read: {error.strerror}", where=str(path)) from None


def triangles(path: Path) -> NDArray[np.float32]:
    """Corners (n, 3, 3) of a mesh, in its own frame and unit. The result is shared and must not be changed.

    Collada states its unit and its upward axis: the corners are in m, with z upwards.

    Raises PluginError for a file that is too large, damaged, empty, or has numbers that are not finite.
    """
    return _triangles(path, _content(path))


@lru_cache(maxsize=256)
def _triangles(path: Path, data: bytes) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):  # infinite, and refused below
        found = {".obj": _obj, ".dae": _dae}.get(path.suffix.lower(), _stl)(data, path)
    if not len(found):
        raise PluginError("no triangles", where=str(path))
    if not np.abs(found).max() <= LARGEST_NUMBER:  # NaN is not
        raise PluginError(f"a coordinate beyond {LARGEST_NUMBER:g}, or not a number", where=str(path))
    return found


def is_flat(path: Path) -> bool:
    """Whether the corners of a mesh are in one plane, except for rounding. Raises PluginError as `triangles`."""
    corners = triangles(path).reshape(-1, 3)
    sizes = np.linalg.svd(corners - corners.mean(0), compute_uv=False)
    return bool(sizes[-1] <= ROUNDING * sizes[0])


def stl(corners: NDArray[np.floating[Any]]) -> bytes:
    """Triangles (n, 3, 3) as binary STL."""
    made = np.zeros(len(corners), _TRIANGLE)
    made["corners"] = corners
    made["normal"] = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    made["normal"] /= np.maximum(np.linalg.norm(made["normal"], axis=1, keepdims=True), 1e-30)
    return bytes(80) + len(made).to_bytes(4, "little") + made.tobytes()


class Solid(NamedTuple):
    """Volume that a mesh encloses, or that of its convex hull if that is not defined; in its own frame and unit."""

    volume: float
    centre: Array
    """Centre of mass (3,)."""
    tensor: Array
    """Inertia (3, 3) about the centre, per mass."""
    filled: str
    """Holes that its convex hull fills, in words; empty for a convex mesh."""
    flaw: str
    """Why its mass is that of its convex hull, in words; empty for a mesh that encloses each place once."""


def solid(path: Path) -> Solid:
    """Volume and inertia of a mesh. Raises PluginError as `triangles`, and for a flat mesh."""
    return _solid(path, _content(path))


@lru_cache(maxsize=256)
def _solid(path: Path, data: bytes) -> Solid:
    import trimesh  # noqa: PLC0415 (takes half a second)
    from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415

    corners, faces = np.unique(_triangles(path, data).reshape(-1, 3), axis=0, return_inverse=True)
    if not _closed(faces.reshape(-1, 3)):
        faces = _welded(corners)[faces]
    try:
        hull = ConvexHull(corners.astype(float))
    except QhullError:
        hint = "a shape that collides needs a thickness"
        raise PluginError("flat: its corners are in one plane", where=str(path), hint=hint) from None
    a, b, c = (faces := faces.reshape(-1, 3)).T
    mesh = trimesh.Trimesh(corners, faces[(a != b) & (b != c) & (c != a)], process=False)
    if not _closed(faces := np.array(mesh.faces)) and mesh.is_watertight:
        trimesh.repair.fix_winding(mesh)  # type: ignore[no-untyped-call]
    flaw = "" if _closed(faces := np.array(mesh.faces)) else "an open surface"
    if not flaw and _enclosed_wrongly(corners[faces]) > TWICE:
        for body in trimesh.graph.connected_components(mesh.face_adjacency, nodes=np.arange(len(faces))):
            if _volumes(corners, faces[body]).sum() < 0:
                faces[body] = faces[body][:, ::-1]
        sound = _closed(faces) and _enclosed_wrongly(corners[faces]) <= TWICE
        flaw = "" if sound else "bodies that overlap or are inside out"
    if not flaw and abs(_volumes(corners, faces).sum()) < LEAST_SHARE * hull.volume:
        flaw = "an open surface"
    if flaw:
        return Solid(*_moments(corners, hull.simplices, convex=True), flaw, flaw)
    volume, centre, tensor = _moments(corners, faces, convex=False)
    holes = mesh.body_count - mesh.euler_number // 2 if mesh.is_watertight else 0  # not where bodies touch
    filled = ""
    if holes > 0:
        filled = "a hole" if holes == 1 else f"{holes} holes"
    elif volume < SAME_VOLUME * hull.volume:
        filled = f"a hollow: {1 - volume / hull.volume:.0%} of it"
    return Solid(volume, centre, tensor, filled, "")


def hull(points: Array) -> Solid:
    """The convex hull of points (n, 3). For fewer than four or flat points: a ball of 6 cm around their middle."""
    from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415

    try:
        found = ConvexHull(points)
    except (QhullError, ValueError):
        middle: Array = points.mean(0) if len(points) else np.zeros(3)
        return Solid(1.13e-4, middle, 0.4 * 0.03**2 * np.eye(3), "", "flat")
    return Solid(*_moments(points, found.simplices, convex=True), "", "")


def _closed(faces: NDArray[np.intp]) -> bool:
    """Whether triangles (n, 3) of corners meet at each edge, with equal numbers in both directions."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    there, back = (np.sort(ends @ [1 + int(faces.max(initial=0)), 1]) for ends in (edges, edges[:, ::-1]))
    return np.array_equal(there, back)


def _welded(corners: NDArray[np.float32]) -> NDArray[np.intp]:
    """For each corner (n, 3) the first corner that is the same except for rounding, (n,)."""
    from scipy.sparse import coo_array  # noqa: PLC0415 (as above)
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415
    from scipy.spatial import KDTree  # noqa: PLC0415

    near = KDTree(corners).query_pairs(ROUNDING * float(np.ptp(corners, axis=0).max()), output_type="ndarray")
    groups: NDArray[np.intp]
    _, groups = connected_components(coo_array((np.ones(len(near)), near.T), (len(corners),) * 2), directed=False)
    first = np.unique(groups, return_index=True)[1]
    return np.take(first, groups)


def _enclosed_wrongly(found: NDArray[np.float32]) -> float:
    """The share of the enclosed volume of a closed mesh (n, 3, 3) that is enclosed twice, or once from behind.

    Each of some lines along the axes enters and leaves the bodies of a sound mesh in turns.
    """
    unit = (found - found.min((0, 1)).astype(float)) / np.ptp(found.reshape(-1, 3), axis=0)
    shares = []
    for turned in (unit, np.roll(unit, 1, 2), np.roll(unit, 2, 2)):
        lengths: Counter[int] = Counter()
        least, most = turned[:, :, :2].min(1), turned[:, :, :2].max(1)
        for number in range(1, min(LINES, MOST_TESTS // len(unit)) + 1):
            # a sequence that fills a square evenly (Roberts' R2), away from the round numbers of a CAD
            place = np.array([0.7548777, 0.5698403]) * number % 1
            near = turned[((least < place) & (place < most)).all(1)]
            x, y = np.moveaxis(near[:, :, :2] - place, 2, 0)
            areas = x[:, [1, 2, 0]] * y[:, [2, 0, 1]] - x[:, [2, 0, 1]] * y[:, [1, 2, 0]]
            hit = (areas > 0).all(1) | (areas < 0).all(1)
            heights = (areas * near[:, :, 2])[hit].sum(1) / areas[hit].sum(1)
            order = np.argsort(heights)
            times = -np.cumsum(np.sign(areas[hit, 0][order]))
            if len(times) and times[-1] == 0:  # a line through an edge may miss it
                for time, length in zip(times.tolist(), np.diff(heights[order]).tolist(), strict=False):
                    lengths[time] += length
        del lengths[0]
        shares.append(1 - max(lengths[1], lengths[-1]) / lengths.total() if lengths.total() else 0.0)
    return max(shares)


def _volumes(corners: NDArray[np.floating[Any]], faces: NDArray[np.intp]) -> Array:
    """Volumes (n,) of the tetrahedra from the mean corner to each triangle; negative behind one."""
    volumes: Array = np.linalg.det(corners[faces] - corners.mean(0).astype(float)) / 6
    return volumes


def _moments(
    corners: NDArray[np.floating[Any]], faces: NDArray[np.intp], *, convex: bool
) -> tuple[float, Array, Array]:
    """Volume, centre and inertia per mass of the space inside triangles: sums over tetrahedra from one point.

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


def warn_of_hull(path: Path, *, weighed: bool = False, accepted: bool = False) -> None:
    """Warn that a mesh which collides, or which determines a mass (`weighed`), is replaced by its convex hull."""
    found = solid(path)
    if found.flaw and weighed:
        hint = "its volume and inertia are those of its convex hull; repair the mesh, in a CAD or Blender"
        warnings.warn(f"{path}: {found.flaw}: {hint}", stacklevel=4)
    elif found.filled and not accepted:
        hint = "collision='decomposed' keeps it, collision='convex' accepts it"
        warnings.warn(f"{path}: its convex hull, which collides, fills {found.filled}; {hint}", stacklevel=4)


def check_size(path: Path, scale: float | Sequence[float]) -> None:
    """Refuse a mesh whose size in m shows a wrong unit. Raises PluginError."""
    size = float((np.ptp(triangles(path).reshape(-1, 3), axis=0) * np.abs(scale)).max())
    if not LEAST_PART <= size <= LARGEST_PART:
        set_ = "scale: 0.001" if isinstance(scale, float) else 'scale="0.001 0.001 0.001"'
        hint = f"in millimetres? set {set_}" if size > LARGEST_PART else "is it in metres already?"
        raise PluginError(f"a part of {size:.3g} m", where=str(path), hint=hint)


def pieces(path: Path) -> tuple[Path, ...]:
    """Files of the convex pieces of a mesh; the mesh itself if it is convex.

    They are kept by their content in the user's cache folder. Raises MachineError if the package coacd is missing or
    the cache cannot be written.
    """
    if solid(path).filled == "":
        return (path,)
    key = hashlib.sha256(f"{CONCAVITY}".encode() + triangles(path).tobytes()).hexdigest()[:24]
    folder = user_cache() / "convex" / key
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
    count, there = int.from_bytes(data[80:84], "little"), max(len(data) - 84, 0) // _TRIANGLE.itemsize
    exact = len(data) == 84 + _TRIANGLE.itemsize * count
    if not exact and b"\0" not in data and _VERTEX.search(data):
        return _ascii_stl(data, path)
    if count in (0, 2**32 - 1):  # its writer could not return to the header
        count = there
    if count != there or not there:  # less than a triangle may follow: a line's end
        what = f"its header counts {count} triangles, {there} follow" if len(data) > 84 else f"{len(data)} bytes"
        raise PluginError(f"not an STL file, or a damaged one: {what}", where=str(path))
    return np.frombuffer(data, _TRIANGLE, count, 84)["corners"]


def _ascii_stl(data: bytes, path: Path) -> NDArray[np.float32]:
    """Upper or lower case, line ends of every system, several bodies; their names are left out."""
    text = re.sub(rb"(?im)^[ \t]*(end)?solid\b.*$", b"", data.replace(b"\r\n", b"\n").replace(b"\r", b"\n"))
    corners = []
    for word in _VERTEX.finditer(text):
        try:
            corners.append([float(one) for one in word.groups()])
        except ValueError:
            line = text.count(b"\n", 0, word.start()) + 1
            raise PluginError("not a corner of three numbers", where=f"{path}:{line}") from None
    facets, ends = len(re.findall(rb"(?i)\bfacet\b", text)), data.lower()
    if len(corners) != 3 * facets or ends.rfind(b"endsolid") < ends.rfind(b"endfacet"):
        raise PluginError(f"cut off, or damaged: {facets} triangles, {len(corners)} corners", where=str(path))
    return np.array(corners, np.float32).reshape(-1, 3, 3)


def _dae(data: bytes, path: Path) -> NDArray[np.float32]:
    import trimesh  # noqa: PLC0415 (takes a second)

    unit, up = (re.search(sign, data) for sign in (rb"<unit\b[^>]*?\bmeter\s*=\s*.([^\"']+)", rb"<up_axis>\s*(\w)"))
    try:
        if re.search(rb"\0|<!(DOCTYPE|ENTITY)|<instance_node", data, re.IGNORECASE):
            raise ValueError("not in UTF-8, a document type, entities, or nodes that stand twice")
        if len(data) * data.count(b"<instance_geometry") > 20 * LARGEST_MESH:
            raise ValueError("too many copies of a geometry")
        scene = trimesh.load_scene(BytesIO(data), file_type="dae", resolver=None)  # which opens no other file
        found = np.array(scene.to_mesh().triangles).reshape(-1, 3, 3) if scene.geometry else np.zeros((0, 3, 3))
        found *= float(unit[1]) if unit else 1.0
    except Exception as error:  # pycollada may raise any error
        raise PluginError(f"cannot be read as Collada: {' '.join(str(error).split())[:200]}", where=str(path)) from None
    x, y, z = np.moveaxis(found, 2, 0)
    turned = {b"Z": (x, y, z), b"X": (-y, -z, x)}.get(up[1] if up else b"Y", (x, -z, y))
    return np.stack(turned, 2).astype(np.float32)


def _obj(data: bytes, path: Path) -> NDArray[np.float32]:
    corners: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for number, line in enumerate(
        data.removeprefix(BOM_UTF8).replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines(), 1
    ):
        word, *rest = line.partition(b"#")[0].split() or [b""]
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
