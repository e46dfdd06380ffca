"""Points on the shapes of a URDF's links, and the files that belong to its meshes."""

from __future__ import annotations

import os
import re
from itertools import product
from pathlib import Path
from xml.etree.ElementTree import Element
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from ..core import Array
from ..simulation import urdf

COMPANIONS = (".mtl", ".png", ".jpg", ".jpeg", ".bmp", ".tga", ".tif", ".tiff", ".gif")
"""File extensions of the materials and pictures that are copied with a mesh."""
_NAMED = {
    ".obj": rb"^\s*mtllib\s+(.+?)\s*$",
    ".mtl": rb"^\s*map_\w+\s+(?:.*\s)?(\S+)\s*$",
    ".dae": rb"<init_from>\s*([^<]+?)\s*</init_from>",
}
"""Patterns of the names of such files, by the extension of the file that they stand in."""


def points_of(robot: Element, link: str) -> Array:
    """Points (n, 3) that span the collision shapes of a link, or its visual ones, in its frame in m."""
    element = next(one for one in robot.findall("link") if one.get("name") == link)
    found = [np.zeros((0, 3))]
    for shape in element.findall("collision") or element.findall("visual"):
        translation, rotation = urdf.origin_of(shape)
        found += [_corners(one) @ rotation.T + translation for one in shape.findall("geometry/*")]
    return np.vstack(found)


def _corners(shape: Element) -> Array:
    """Points (n, 3) of a shape in its own frame. A mesh of a format that is not read here has none."""
    size = {key: [float(one) for one in value.split()] for key, value in shape.attrib.items() if key != "filename"}
    if shape.tag == "mesh":
        scaled: Array = _vertices(Path(shape.get("filename", ""))) * np.array(size.get("scale", [1.0]))
        return scaled
    if shape.tag == "box":
        half = np.array(size["size"]) / 2
    else:
        radius, length = size["radius"][0], size.get("length", [0.0])[0]
        half = np.array([radius, radius, length / 2 if shape.tag == "cylinder" else length / 2 + radius])
    corners: Array = half * np.array(list(product((-1, 1), repeat=3)))
    return corners


def _vertices(path: Path) -> Array:
    """Vertices (n, 3) of a mesh."""
    data = path.read_bytes()
    if path.suffix.lower() == ".stl" and len(data) == 84 + 50 * (count := int.from_bytes(data[80:84], "little")):
        triangle = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
        return np.frombuffer(data, triangle, count, 84)["corners"].reshape(-1, 3).astype(float)
    word = {".stl": rb"vertex", ".obj": rb"v"}.get(path.suffix.lower(), rb"no such line")
    lines = re.findall(rb"^\s*" + word + rb"\s+(\S+)\s+(\S+)\s+(\S+)", data, re.MULTILINE)
    return np.array(lines, float).reshape(-1, 3)


def files_of(mesh: Path) -> list[Path]:
    """A mesh and the materials and pictures that it names, as far as they lie below its folder."""
    found, below = [mesh], mesh.parent.resolve()
    for file in found:  # grows while it is read
        pattern = _NAMED.get(file.suffix.lower())
        for name in re.findall(pattern, file.read_bytes(), re.MULTILINE) if pattern else ():
            other = Path(os.path.realpath(file.parent / os.fsdecode(name.replace(b"\0", b""))))
            if other.suffix.lower() in COMPANIONS and other.is_relative_to(below) and other.is_file():
                found += [other] if other not in found else []
    return found


def with_meshes(path: Path) -> tuple[str, dict[str, Path]]:
    """A URDF whose meshes are in the folder `meshes` beside it, and the files to copy there by their new names.

    Bytes of the text that are not UTF-8 are surrogates.
    """
    text = path.read_text("utf-8", "surrogateescape")
    names = {mesh.get("filename", "") for mesh in urdf.read(path).iter("mesh")}
    meshes = {name: mesh for name in names if (mesh := urdf.find_mesh(name, path.parent)) is not None}
    files = {file for mesh in meshes.values() for file in files_of(mesh)}
    if not files:
        return text, {}
    top = Path(os.path.commonpath([file.parent for file in files]))
    new = {file: f"meshes/{file.relative_to(top).as_posix()}" for file in files}
    for name, mesh in meshes.items():
        parts = re.split(rf"""(["']){re.escape(escape(name))}\1""", text)
        text = quoteattr(new[mesh]).join(parts[::2])
    return text, {to: file for file, to in new.items()}
