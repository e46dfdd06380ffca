"""Fixtures and objects with joints, and arms, read from a URDF or MJCF file."""

from __future__ import annotations

import copy
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

from ..errors import PluginError
from . import meshes, urdf
from .parts import Mechanism


def read(path: Path, collision: meshes.Collision | None = None) -> Mechanism:
    """A fixture or an object with joints from a URDF or MJCF file.

    Args:
        collision: collision shapes of its meshes; by default their hulls, with a warning if a hull fills a hole.

    Raises:
        PluginError: the file holds an element that karolos does not know or cannot simulate; names element and line.
    """
    root, lines = urdf.parse(path, urdf.text_of(path))
    if root.tag == "mujoco":
        made: Mechanism = _mjcf().fixture(path, root, lines, collision)
        return made
    description = urdf.load(path, driven=False)
    for joint in description.joints:
        if joint.mimic is not None:
            raise PluginError(
                f"it mimics {joint.mimic}, which is possible only with a motor", where=f"{path}: joint {joint.name}"
            )
    robot = copy.deepcopy(description.robot)
    for link in robot.findall("link"):
        for shape in link.findall("collision"):
            if (mesh := shape.find("geometry/mesh")) is None:
                continue
            file = Path(mesh.get("filename", ""))
            if collision is None:
                meshes.warn_of_hull(file)
            elif collision == "decomposed":
                if link.find("visual") is None:
                    SubElement(link, "visual").extend(copy.deepcopy(list(shape)))
                link.remove(shape)
                for piece in meshes.pieces(file):
                    mesh.set("filename", str(piece))
                    link.append(copy.deepcopy(shape))
    return Mechanism(robot, {joint.name: joint.friction for joint in description.joints})


def hulls(robot: Element) -> dict[str, str]:
    """Holes that the convex hulls of a URDF's meshes fill, by link; links without such holes are left out."""
    found = {}
    for link in robot.findall("link"):
        files = [Path(mesh.get("filename", "")) for mesh in link.iterfind("collision/geometry/mesh")]
        if what := [filled for file in files if (filled := meshes.solid(file).filled)]:
            found[link.get("name", "")] = what[0]
    return found


def arm(path: Path, speed: float, slide: float) -> Element:
    """The URDF of an arm in an MJCF file, with absolute names of meshes; see `mjcf.arm`.

    Raises PluginError if it is not an MJCF file of one arm. The message names element and line.
    """
    root, lines = urdf.parse(path, urdf.text_of(path))
    if root.tag != "mujoco":
        hint = f"a URDF is called {path.stem}.urdf" if root.tag == "robot" else "its root is <mujoco>"
        raise PluginError("not an MJCF file", where=str(path), hint=hint)
    robot: Element = _mjcf().arm(path, root, lines, speed, slide)
    return robot


def _mjcf() -> Any:
    """The module that reads MJCF; it imports MuJoCo."""
    return import_module(".mujoco.mjcf", __package__)
