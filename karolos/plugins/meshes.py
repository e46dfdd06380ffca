"""Points on the shapes of a URDF's links, and a URDF whose meshes stand beside it."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path
from xml.etree.ElementTree import Element
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from ..core import Array
from ..simulation import urdf
from ..simulation.meshes import MESH_SUFFIXES, triangles


def points_of(robot: Element, link: str) -> Array:
    """Points (n, 3) that span the collision shapes of a link, or its visual ones, in its frame in m."""
    element = next(one for one in robot.findall("link") if one.get("name") == link)
    found = [np.zeros((0, 3))]
    for shape in element.findall("collision") or element.findall("visual"):
        translation, rotation = urdf.origin_of(shape)
        found += [_corners(one) @ rotation.T + translation for one in shape.findall("geometry/*")]
    return np.vstack(found)


def _corners(shape: Element) -> Array:
    """Points (n, 3) of a shape in its own frame."""
    size = {key: [float(one) for one in value.split()] for key, value in shape.attrib.items() if key != "filename"}
    if shape.tag == "mesh":
        scale = np.array(size.get("scale", [1.0, 1.0, 1.0]))
        return scale * triangles(Path(shape.get("filename", ""))).reshape(-1, 3)
    if shape.tag == "box":
        half = np.array(size["size"]) / 2
    else:
        radius, length = size["radius"][0], size.get("length", [0.0])[0]
        half = np.array([radius, radius, length / 2 if shape.tag == "cylinder" else length / 2 + radius])
    corners: Array = half * np.array(list(product((-1, 1), repeat=3)))
    return corners


def with_meshes(path: Path) -> tuple[str, dict[str, Path]]:
    """A URDF whose meshes are in the folder `meshes` beside it, and the files to copy there by their new names."""
    text, files = urdf.text_of(path), dict[str, Path]()
    for number, name in enumerate(sorted({mesh.get("filename", "") for mesh in urdf.read(path).iter("mesh")})):
        mesh = urdf.find_mesh(name, path.parent)
        if mesh is not None and mesh.suffix.lower() in MESH_SUFFIXES:
            new = next((to for to, file in files.items() if file == mesh), f"meshes/{number}_{mesh.name}")
            files[new] = mesh
            text = quoteattr(new).join(re.split(rf"""(["']){re.escape(escape(name))}\1""", text)[::2])
    return text, files
