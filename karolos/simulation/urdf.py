"""URDF files: joints with their origins and limits, and welding of joints that a task never moves.

Units: m, rad, kg, N m (N for prismatic joints), rad/s (m/s). No engine is needed.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from ..core import Array
from ..errors import PluginError
from .geometry import Vector


@dataclass(frozen=True)
class Joint:
    """One moving joint. `rotation` (3, 3) as rows: the frame of the joint in its parent's, at position 0."""

    name: str
    parent: str
    child: str
    revolute: bool
    origin: Vector
    rotation: tuple[Vector, ...]
    axis: Vector
    lower: float
    upper: float
    effort: float
    velocity: float


def rotation_matrix(roll: float, pitch: float, yaw: float) -> Array:
    """Rotation (3, 3) of URDF's roll, pitch, yaw in rad: Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def roll_pitch_yaw(rotation: Array) -> tuple[float, float, float]:
    """The inverse of `rotation_matrix`, for a pitch within (-pi/2, pi/2); at the poles the roll is set to 0."""
    level = np.hypot(rotation[0, 0], rotation[1, 0])
    pitch = float(np.arctan2(-rotation[2, 0], level))
    if level < 1e-9:
        return 0.0, pitch, float(np.arctan2(-rotation[0, 1], rotation[1, 1]))
    return float(np.arctan2(rotation[2, 1], rotation[2, 2])), pitch, float(np.arctan2(rotation[1, 0], rotation[0, 0]))


def read(path: Path) -> Element:
    """The <robot> element of a URDF. Raises PluginError when the file is missing or not a URDF."""
    try:
        root = ElementTree.parse(path).getroot()
    except OSError as error:
        raise PluginError(f"cannot read {path.name}: {error.strerror}", where=str(path.parent)) from error
    except ElementTree.ParseError as error:
        raise PluginError(f"not an XML file: {error}", where=str(path), hint="a robot needs a valid URDF") from error
    if root.tag != "robot" or root.find("link") is None:
        raise PluginError("not a URDF: it needs a <robot> with links", where=str(path))
    return root


@cache
def joints(path: Path) -> tuple[Joint, ...]:
    """The movable joints, in the order of the file. Raises PluginError when the description of one is incomplete."""
    return tuple(_joint(element, path) for element in read(path).iter("joint") if element.get("type") != "fixed")


def _joint(element: Element, path: Path) -> Joint:
    name = element.get("name", "?")
    kind = element.get("type")
    limit, parent, child = element.find("limit"), element.find("parent"), element.find("child")
    where = f"{path}: joint {name}"
    if kind not in {"revolute", "prismatic"}:
        raise PluginError(f"a {kind} joint", where=where, hint="joints are revolute, prismatic or fixed")
    if limit is None or parent is None or child is None:
        raise PluginError("a joint without parent, child or limit", where=where)
    origin, rotation = _origin(element)
    try:
        lower, upper, effort, velocity = (float(limit.attrib[key]) for key in ("lower", "upper", "effort", "velocity"))
        axis = _axis(element)
    except (KeyError, ValueError) as error:
        raise PluginError(f"limit or axis is not readable: {error}", where=where) from error
    if not lower < upper or effort <= 0 or velocity <= 0:
        raise PluginError("limits must satisfy lower < upper, effort > 0, velocity > 0", where=where)
    return Joint(
        name=name,
        parent=parent.get("link", ""),
        child=child.get("link", ""),
        revolute=kind == "revolute",
        origin=_vector(origin),
        rotation=tuple(_vector(row) for row in rotation),
        axis=axis,
        lower=lower,
        upper=upper,
        effort=effort,
        velocity=velocity,
    )


def _vector(values: Iterable[str | float]) -> Vector:
    x, y, z = map(float, values)
    return x, y, z


def _axis(joint: Element) -> Vector:
    axis = joint.find("axis")
    return _vector((axis.get("xyz", "1 0 0") if axis is not None else "1 0 0").split())


def _origin(element: Element) -> tuple[Array, Array]:
    """Translation (3,) and rotation (3, 3) of an element's <origin>."""
    origin = element.find("origin")
    if origin is None:
        return np.zeros(3), np.eye(3)
    translation = np.array(_vector(origin.get("xyz", "0 0 0").split()))
    return translation, rotation_matrix(*_vector(origin.get("rpy", "0 0 0").split()))


def weld(robot: Element, positions: Mapping[str, float]) -> Element:
    """A copy with the named joints fixed at these positions and their links merged into their parents.

    A link costs about a tenth of an arm's physics step, so a gripper that a task never moves is not simulated.
    """
    robot = copy.deepcopy(robot)
    links = {link.get("name"): link for link in robot.findall("link")}
    for element in robot.findall("joint"):
        position = positions.get(element.get("name", ""))
        if position is None:
            continue
        parent, child = (links[_link(element, role)] for role in ("parent", "child"))
        translation, rotation = _origin(element)
        translation = translation + rotation @ np.array(_axis(element)) * position
        _merge_inertia(parent, child, translation, rotation)
        for shape in [*child.findall("visual"), *child.findall("collision")]:
            offset, turn = _origin(shape)
            _set_origin(shape, translation + rotation @ offset, rotation @ turn)
            parent.append(shape)
        robot.remove(element)
        robot.remove(child)
    return robot


def _link(element: Element, role: str) -> str:
    link = element.find(role)
    return "" if link is None else link.get("link", "")


def _set_origin(element: Element, translation: Array, rotation: Array) -> None:
    origin = element.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(element, "origin")
    origin.set("xyz", " ".join(repr(float(value)) for value in translation))
    origin.set("rpy", " ".join(repr(value) for value in roll_pitch_yaw(rotation)))


_INERTIA = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}


def _inertia(link: Element) -> tuple[float, Array, Array]:
    """Mass, centre of mass (3,) and inertia (3, 3) about it, in the link's frame."""
    inertial = link.find("inertial")
    if inertial is None:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    mass, numbers = inertial.find("mass"), inertial.find("inertia")
    centre, rotation = _origin(inertial)
    tensor = np.zeros((3, 3))
    if numbers is not None:
        for key, (row, column) in _INERTIA.items():
            tensor[row, column] = tensor[column, row] = float(numbers.get(key, "0"))
    return float(mass.get("value", "0")) if mass is not None else 0.0, centre, rotation @ tensor @ rotation.T


def _merge_inertia(parent: Element, child: Element, translation: Array, rotation: Array) -> None:
    """Add the child's mass to its parent's: parallel-axis theorem."""
    parts = [_inertia(parent)]
    mass, centre, tensor = _inertia(child)
    parts.append((mass, translation + rotation @ centre, rotation @ tensor @ rotation.T))
    total = sum(part[0] for part in parts)
    middle = sum((part[0] * part[1] for part in parts), np.zeros(3)) / total
    merged = np.zeros((3, 3))
    for mass, centre, tensor in parts:
        offset = centre - middle
        merged += tensor + mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    old = parent.find("inertial")
    if old is not None:
        parent.remove(old)
    inertial = ElementTree.SubElement(parent, "inertial")
    _set_origin(inertial, middle, np.eye(3))
    ElementTree.SubElement(inertial, "mass").set("value", repr(float(total)))
    numbers = ElementTree.SubElement(inertial, "inertia")
    for key, (row, column) in _INERTIA.items():
        numbers.set(key, repr(float(merged[row, column])))
