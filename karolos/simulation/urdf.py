"""URDF files as exporters write them: what is simulated of a robot, and its joints with their origins and limits.

Units: m, rad, kg, N m (N for prismatic joints), rad/s (m/s). No engine is needed.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from math import hypot, isfinite, pi
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from ..core import Array
from ..errors import PluginError
from .geometry import Vector

MESH_SUFFIXES = (".stl", ".obj", ".dae")
"""File extensions of the meshes that an engine can read."""
FINGER_MASS = 0.05
"""Least mass in kg of a finger, with the drive that moves with it. A finger of 15 g grips with 21 instead of 30 N: the
solver would need more iterations than are worth their time."""
CONTINUOUS_RANGE = 2 * pi
"""Range in rad to each side of a continuous joint."""


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
    """Largest torque of its motor, without what dry friction (`<dynamics friction>`) takes of it."""
    velocity: float
    mimic: str | None = None
    """The joint whose position this one follows."""


@dataclass(frozen=True)
class Description:
    """What is simulated of a URDF."""

    robot: Element
    """Links, moving joints and materials only. Meshes have absolute file names."""
    joints: tuple[Joint, ...]
    """The moving joints, from the base outwards."""
    carriers: Mapping[str, str]
    """Link of the file -> link of `robot` into which it is merged."""
    corrected: tuple[str, ...] = ()
    """Links whose inertia no body can have: the smaller principal moments are raised to what is possible."""


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
    # `from None`: the line says it all, and the command line prints the traceback of a cause.
    except OSError as error:
        raise PluginError(f"cannot read {path.name}: {error.strerror}", where=str(path.parent)) from None
    except ElementTree.ParseError as error:
        raise PluginError(f"not an XML file: {error}", where=str(path), hint="a robot needs a valid URDF") from None
    if any("ros.org/wiki/xacro" in element.tag for element in root):
        hint = f"expand it first: xacro {path.name} > robot.urdf"
        raise PluginError("macros of xacro, which are not expanded", where=str(path), hint=hint)
    if root.tag != "robot" or root.find("link") is None:
        raise PluginError("not a URDF: it needs a <robot> with links", where=str(path))
    return root


@cache
def load(
    path: Path, locked: tuple[tuple[str, float], ...] = (), slides: tuple[str, ...] = (), strict: bool = True
) -> Description:
    """What is simulated of a URDF. The result is shared and must not be changed.

    Fixed joints and locked joints are merged, with the links that they move, into their parents. What exporters write
    for other programs (transmissions, ros2_control, gazebo, mimic, safety controllers) is left out. A continuous joint
    becomes a revolute one with `CONTINUOUS_RANGE` to each side. The range of the `slides` begins at 0, and what they
    move weighs at least `FINGER_MASS`.

    Args:
        path: of the file.
        locked: joints that are held at a position, in rad or m. Joints that mimic one of them are held, too.
        slides: prismatic joints of a gripper.
        strict: whether limits, masses and meshes must be such that the robot can be simulated.

    Raises:
        PluginError: names the joint or link that is not as a URDF must be, or that cannot be simulated.
    """
    robot = copy.deepcopy(read(path))
    for element in [*robot]:
        if element.tag not in ("link", "joint", "material"):
            robot.remove(element)
    order = _tree(robot, path)
    held = _held(order, dict(locked), path)
    carriers: dict[str, str] = {}
    for element in order:
        parent, child = link_of(element, "parent"), link_of(element, "child")
        carriers.setdefault(parent, parent)
        carriers[child] = carriers[parent] if element.get("name") in held else child
    if strict:
        _find_meshes(robot, path)
    with _readable(path, "a number"):
        robot = weld(robot, held)
    moving = [element for element in order if element.get("name") not in held]
    elements = {element.get("name"): element for element in robot.findall("joint")}
    found = []
    for element in (elements[one.get("name")] for one in moving):
        where = f"{path}: joint {element.get('name')}"
        with _readable(where, "limit or axis"):
            _make_simple(element, element.get("name") in slides)
            found.append(_joint(element, where, strict=strict))
    corrected = []
    if strict:
        root = carriers[link_of(order[0], "parent")] if order else ""
        fingers = {joint.child for joint in found if joint.name in slides}
        for link in robot.findall("link"):
            name = link.get("name", "")
            if _check_link(link, path, base=name == root, least=FINGER_MASS if name in fingers else 0.0):
                corrected.append(name)
    return Description(robot, tuple(found), carriers, tuple(corrected))


@contextmanager
def _readable(where: object, what: str) -> Iterator[None]:
    """Turn the errors of numbers that cannot be read into a PluginError."""
    try:
        yield
    except (KeyError, ValueError) as error:
        raise PluginError(f"{what} is not readable: {error}", where=str(where)) from error


def _tree(robot: Element, path: Path) -> list[Element]:
    """The joints from the base outwards, each after the one that moves its parent. Raises PluginError for no tree."""
    elements = robot.findall("joint")
    links = [link.get("name", "?") for link in robot.findall("link")]
    for what, names in (("link", links), ("joint", [element.get("name", "?") for element in elements])):
        for name in names:
            if names.count(name) > 1:
                raise PluginError("two of this name", where=f"{path}: {what} {name}")
    above: dict[str, Element] = {}
    for element in elements:
        where = f"{path}: joint {element.get('name', '?')}"
        kind = element.get("type")
        if kind not in {"revolute", "continuous", "prismatic", "fixed"}:
            hint = "joints are revolute, continuous, prismatic or fixed"
            raise PluginError(f"a {kind} joint", where=where, hint=hint)
        if element.find("parent") is None or element.find("child") is None:
            raise PluginError("a joint without parent or child", where=where)
        for role in ("parent", "child"):
            if link_of(element, role) not in links:
                raise PluginError(f"there is no link {link_of(element, role)!r}", where=where)
        child = link_of(element, "child")
        if child in above:
            raise PluginError(f"link {child!r} is also the child of joint {above[child].get('name')}", where=where)
        above[child] = element
    roots = [name for name in links if name not in above]
    if len(roots) != 1:
        raise PluginError(
            f"{len(roots)} links without a joint above them: {', '.join(roots) or 'the joints form a circle'}",
            where=str(path),
            hint="exactly one link is the base",
        )
    order, reached = [], roots
    while reached:
        further = [element for element in elements if link_of(element, "parent") == reached[0]]
        order += further
        reached = [*(link_of(element, "child") for element in further), *reached[1:]]
    if len(order) < len(elements):
        circle = next(element for element in elements if element not in order)
        raise PluginError("not connected to the base", where=f"{path}: joint {circle.get('name')}")
    return order


def _held(order: Iterable[Element], locked: dict[str, float], path: Path) -> dict[str, float]:
    """The position of every joint that does not move: fixed ones, locked ones and those that mimic a locked one."""
    held = {element.get("name", "?"): 0.0 for element in order if element.get("type") == "fixed"}
    names = [element.get("name", "?") for element in order]
    for name in locked:
        if name not in names:
            raise PluginError(f"no joint is called {name!r}", where=str(path), hint=f"joints: {', '.join(names)}")
    held.update(locked)
    mimics = {element.get("name", "?"): one for element in order if (one := element.find("mimic")) is not None}
    for _ in mimics:  # a mimic joint may follow another
        for name, mimic in mimics.items():
            leader = mimic.get("joint", "")
            if leader in held and name not in held:
                with _readable(f"{path}: joint {name}", "mimic"):
                    held[name] = held[leader] * float(mimic.get("multiplier", "1")) + float(mimic.get("offset", "0"))
    return held


def _make_simple(element: Element, slide: bool) -> None:
    """Make a continuous joint a revolute one, and let the range of a slide of the gripper begin at 0."""
    limit = element.find("limit")
    if element.get("type") == "continuous" and limit is not None:
        element.set("type", "revolute")
        limit.set("lower", repr(-CONTINUOUS_RANGE))
        limit.set("upper", repr(CONTINUOUS_RANGE))
    if slide and limit is not None:
        lower, upper, axis = float(limit.attrib["lower"]), float(limit.attrib["upper"]), np.array(_axis(element))
        if -lower > upper:
            lower, upper, axis = -upper, -lower, -axis
        if lower or not np.array_equal(axis, _axis(element)):
            translation, rotation = origin_of(element)
            _set_origin(element, translation + rotation @ axis * lower, rotation)
            for old in element.findall("axis"):
                element.remove(old)
            ElementTree.SubElement(element, "axis").set("xyz", " ".join(map(repr, axis.tolist())))
            limit.set("lower", "0.0")
            limit.set("upper", repr(upper - lower))


def _joint(element: Element, where: str, *, strict: bool) -> Joint:
    limit, mimic, dynamics = element.find("limit"), element.find("mimic"), element.find("dynamics")
    for other in ("mimic", "safety_controller", "calibration"):
        for one in element.findall(other):
            element.remove(one)
    friction = 0.0
    if dynamics is not None:  # engines treat it differently, and one ignores it
        friction = float(dynamics.attrib.pop("friction", "0"))
    if limit is None and strict:
        raise PluginError("a joint without limit", where=where, hint="<limit lower upper effort velocity>")
    values = limit.attrib if limit is not None else {}
    keys = ("lower", "upper", "effort", "velocity")
    lower, upper, effort, velocity = (float(values[key] if strict else values.get(key, "0")) for key in keys)
    axis, effort = _axis(element), effort - friction
    if not any(axis):
        raise PluginError("its axis is 0 0 0", where=where)
    if strict and not (lower < upper and effort > 0 and velocity > 0):
        raise PluginError(
            f"limits must satisfy lower < upper, effort > {friction:g}, velocity > 0",
            where=where,
            hint="write the numbers of the data sheet into <limit>; exporters leave zeros",
        )
    origin, rotation = origin_of(element)
    return Joint(
        name=element.get("name", "?"),
        parent=link_of(element, "parent"),
        child=link_of(element, "child"),
        revolute=element.get("type") != "prismatic",
        origin=_vector(origin),
        rotation=tuple(_vector(row) for row in rotation),
        axis=axis,
        lower=lower,
        upper=upper,
        effort=effort,
        velocity=velocity,
        mimic=None if mimic is None else mimic.get("joint"),
    )


def _find_meshes(robot: Element, path: Path) -> None:
    """Give every mesh its absolute file name. Raises PluginError, which names the link, for a mesh that is missing."""
    for link in robot.findall("link"):
        where = f"{path}: link {link.get('name')}"
        for mesh in link.iter("mesh"):
            name = mesh.get("filename", "")
            found = find_mesh(name, path.parent)
            if found is None:
                raise PluginError(
                    f"there is no mesh {name!r}",
                    where=where,
                    hint="it is looked for beside the URDF and in folders above",
                )
            if found.suffix.lower() not in MESH_SUFFIXES:
                raise PluginError(
                    f"cannot read the mesh {name!r}", where=where, hint=f"meshes end in {', '.join(MESH_SUFFIXES)}"
                )
            mesh.set("filename", str(found))


def _check_link(link: Element, path: Path, *, base: bool, least: float) -> bool:
    """Check the mass and the inertia of a link. Returns whether the inertia had to be corrected.

    Args:
        link: the <link>.
        path: of the URDF.
        base: whether it is fixed and needs no mass.
        least: mass in kg to which it is raised, and its inertia with it.
    """
    where = f"{path}: link {link.get('name')}"
    with _readable(where, "inertial"):
        mass, centre, tensor = _inertia(link)
    if base:
        if link.find("inertial") is None:  # an engine would guess
            _set_inertia(link, 1.0, centre, np.eye(3))
        return False
    if not (isfinite(mass) and mass > 0):
        raise PluginError("it moves and has no mass", where=where, hint="write its <inertial>")
    if not (np.isfinite(tensor).all() and np.linalg.eigvalsh(tensor)[0] > 0):
        raise PluginError("its inertia is not positive definite", where=where, hint="correct its <inertial>")
    if mass < least:
        mass, tensor = least, tensor * (least / mass)
        _set_inertia(link, mass, centre, tensor)
    moments, axes = np.linalg.eigh(tensor)
    missing = 1.001 * moments[2] - moments[0] - moments[1]  # engines set the inertia to 0, or refuse it
    if missing <= 0.001 * moments[2]:
        return False
    _set_inertia(link, mass, centre, axes @ np.diag(moments + np.array([missing / 2, missing / 2, 0.0])) @ axes.T)
    return True


def find_mesh(name: str, folder: Path) -> Path | None:
    """The file of a mesh, named as in a URDF that stands in `folder`; None if there is none.

    A `package://` name is looked for in this folder and those above it, with and without the name of the package.
    """
    scheme, separator, rest = name.partition("://")
    if scheme in ("package", "model") and separator:
        places = [
            place for above in (folder, *folder.parents) for place in (above / rest, above / rest.partition("/")[2])
        ]
    else:
        rest = rest if separator else name
        places = [folder / rest, folder.parent / rest]
    return next((place.resolve() for place in places if place.is_file()), None)


def _vector(values: Iterable[str | float]) -> Vector:
    x, y, z = map(float, values)
    return x, y, z


def _axis(joint: Element) -> Vector:
    """The axis, of length 1."""
    axis = joint.find("axis")
    vector = _vector((axis.get("xyz", "1 0 0") if axis is not None else "1 0 0").split())
    length = hypot(*vector)
    return vector if length in (0, 1) else _vector(np.divide(vector, length))


def origin_of(element: Element) -> tuple[Array, Array]:
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
        parent, child = (links[link_of(element, role)] for role in ("parent", "child"))
        translation, rotation = origin_of(element)
        if element.get("type") == "prismatic":
            translation = translation + rotation @ np.array(_axis(element)) * position
        elif position:
            rotation = rotation @ about(_axis(element), position)
        _merge_inertia(parent, child, translation, rotation)
        for shape in [*child.findall("visual"), *child.findall("collision")]:
            _move(shape, translation, rotation)
            parent.append(shape)
        for other in robot.findall("joint"):
            if link_of(other, "parent") == child.get("name"):
                _move(other, translation, rotation)
                other.findall("parent")[0].set("link", parent.get("name", ""))
        robot.remove(element)
        robot.remove(child)
    return robot


def about(axis: Vector, angle: float) -> Array:
    """Rotation (3, 3) by an angle in rad about an axis of length 1 (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation: Array = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return rotation


def _move(element: Element, translation: Array, rotation: Array) -> None:
    """Give an element, which has an <origin>, that origin in the frame that its own frame stands in."""
    offset, turn = origin_of(element)
    _set_origin(element, translation + rotation @ offset, rotation @ turn)


def link_of(element: Element, role: str) -> str:
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
    centre, rotation = origin_of(inertial)
    tensor = np.zeros((3, 3))
    if numbers is not None:
        for key, (row, column) in _INERTIA.items():
            tensor[row, column] = tensor[column, row] = float(numbers.get(key, "0"))
    return float(mass.get("value", "0")) if mass is not None else 0.0, centre, rotation @ tensor @ rotation.T


def _merge_inertia(parent: Element, child: Element, translation: Array, rotation: Array) -> None:
    """Add the child's mass to its parent's: parallel-axis theorem."""
    parts = [_inertia(parent)]
    mass, centre, tensor = _inertia(child)
    if not mass:  # a frame without a body
        return
    parts.append((mass, translation + rotation @ centre, rotation @ tensor @ rotation.T))
    total = sum(part[0] for part in parts)
    middle = sum((part[0] * part[1] for part in parts), np.zeros(3)) / total
    merged = np.zeros((3, 3))
    for mass, centre, tensor in parts:
        offset = centre - middle
        merged += tensor + mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    _set_inertia(parent, float(total), middle, merged)


def _set_inertia(link: Element, mass: float, centre: Array, tensor: Array) -> None:
    old = link.find("inertial")
    if old is not None:
        link.remove(old)
    inertial = ElementTree.SubElement(link, "inertial")
    _set_origin(inertial, centre, np.eye(3))
    ElementTree.SubElement(inertial, "mass").set("value", repr(mass))
    numbers = ElementTree.SubElement(inertial, "inertia")
    for key, (row, column) in _INERTIA.items():
        numbers.set(key, repr(float(tensor[row, column])))
