"""Reads URDF files of any exporter: the simulated part of a robot, and its joints with origins and limits.

Units: m, rad, kg, N m (N for prismatic joints), rad/s (m/s). No engine is needed.
"""

from __future__ import annotations

import copy
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import hypot, nan, pi
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.parsers import expat

import numpy as np

from ..core import Array
from ..errors import PluginError
from ..system.files import find_named, install_hint
from .geometry import Vector, vector
from .meshes import LARGEST_NUMBER, MESH_SUFFIXES, check_size, is_flat

FINGER_MASS = 0.05
"""Smallest mass in kg of a finger with its drive. The solver has too few iterations for lighter ones, which would grip
with less than their force (docs/physics.md)."""
CONTINUOUS_RANGE = 2 * pi
"""Range in rad to each side of a continuous joint."""
LEAST_SIZE = 1e-6
"""Smallest length of a shape in m, and smallest mass of a moving link in kg."""
LEAST_INERTIA = 1e-12
"""Smallest principal moment of a moving link in kg m2."""
MOST_LINKS, MOST_JOINTS = 1000, 12
"""Largest number of links in a file, and of moving joints. Engines take minutes for a chain of a hundred joints."""
LONGEST_FILE, LONGEST_NAME = 20_000_000, 100
"""Largest size of a file in bytes, and of a name in characters: PyBullet copies names into arrays of fixed size."""

_INERTIA = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}
_LIMITS = ("lower", "upper", "effort", "velocity")
_SHAPES = ("box", "sphere", "cylinder", "capsule")
_KNOWN = {
    "robot": "@name link* joint* material*",
    "link": "@name inertial visual* collision*",
    "joint": "@name @type origin parent child axis limit dynamics mimic",
    "inertial": "origin mass inertia",
    "visual": "origin geometry material",
    "collision": "origin geometry",
    "geometry": "box sphere cylinder capsule mesh",
    "material": "@name color",
    "parent": "@link",
    "child": "@link",
    "mimic": "@joint multiplier=1 offset=1",
    "origin": "xyz=3 rpy=3",
    "axis": "xyz=3",
    "mass": "value=1",
    "inertia": " ".join(f"{key}=1" for key in _INERTIA),
    "limit": " ".join(f"{key}=1" for key in _LIMITS),
    "dynamics": "damping=1 friction=1",
    "box": "size=3",
    "sphere": "radius=1",
    "cylinder": "radius=1 length=1",
    "capsule": "radius=1 length=1",
    "mesh": "@filename scale=3",
    "color": "rgba=4",
}
"""Kept content of each element: @texts, numbers with their count, and parts; a * marks parts that may repeat."""
_LEAST = {**dict.fromkeys(_SHAPES, LEAST_SIZE), "mass": 0.0, "dynamics": 0.0}
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d{1,3})?", re.ASCII)


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
    """Largest torque of its motor, without the part that dry friction (`<dynamics friction>`) needs."""
    velocity: float
    mimic: str | None = None
    """Joint whose position this one follows."""
    friction: float = 0.0
    """Dry friction, N m or N."""


@dataclass(frozen=True)
class Mount:
    """The URDF of a gripper on a link of an arm. Its links and joints get names that begin with `name`/."""

    name: str
    path: Path
    link: str
    """Link of the arm."""
    position: Vector
    """Position of the gripper's base in the frame of that link, in m."""
    rpy: Vector

    def named(self, name: str) -> str:
        """The name of a link or joint of the gripper on the arm."""
        return f"{self.name}/{name}"


@dataclass(frozen=True)
class Description:
    """The simulated part of a URDF."""

    robot: Element
    """Links, moving joints and materials only. Meshes have absolute file names."""
    joints: tuple[Joint, ...]
    """The moving joints, from the base outwards."""
    carriers: Mapping[str, str]
    """Link of the file -> link of `robot` into which it is merged."""
    frames: Mapping[str, tuple[Array, Array]]
    """Link of the file -> its translation (3,) and rotation (3, 3) in the frame of its carrier."""
    corrected: tuple[str, ...] = ()
    """Links with an impossible inertia: their smaller principal moments are raised to possible values."""
    stopped: tuple[str, ...] = ()
    """Joints that move in a plane or freely in the file, and not here."""


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
    """The inverse of `rotation_matrix`, for a pitch in (-pi/2, pi/2). At the poles the roll is 0."""
    level = np.hypot(rotation[0, 0], rotation[1, 0])
    pitch = float(np.arctan2(-rotation[2, 0], level))
    if level < 1e-9:
        return 0.0, pitch, float(np.arctan2(-rotation[0, 1], rotation[1, 1]))
    return float(np.arctan2(rotation[2, 1], rotation[2, 2])), pitch, float(np.arctan2(rotation[1, 0], rotation[0, 0]))


def text_of(path: Path) -> str:
    """The text of a URDF. Raises PluginError when the file is missing, too large or not in UTF-8."""
    # `from None`: the line is enough, and the command line would print the traceback of a cause
    try:
        if path.stat().st_size > LONGEST_FILE:
            raise PluginError(f"larger than {LONGEST_FILE / 1e6:g} MB", where=str(path))
        return path.read_text("utf-8-sig")
    except OSError as error:
        hint = install_hint(str(path))
        raise PluginError(f"cannot be read ({error.strerror})", where=str(path), hint=hint) from None
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise PluginError("not in UTF-8", where=f"{path}:{line}", hint="save it as UTF-8") from None


def parse(path: Path, text: str) -> tuple[Element, dict[Element, int]]:
    """The root of an XML file with this text, and the line of each element. Raises PluginError if it is not XML.

    Elements of the root's namespace, as in Drake's files, have their plain names.
    """
    lines: dict[Element, int] = {}
    spaces: list[str] = []
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate("utf-8", "}")

    def start(tag: str, attributes: dict[str, str]) -> None:
        space, _, name = tag.rpartition("}")
        spaces.append(space)
        lines[builder.start(name if space == spaces[0] else tag, attributes)] = parser.CurrentLineNumber

    def refuse_entity(name: str, *_: object) -> None:  # a few lines of them can expand to gigabytes
        raise PluginError(
            f"it declares the entity {short(name)}; entities are not allowed in a URDF",
            where=f"{path}:{parser.CurrentLineNumber}",
        )

    def end(tag: str) -> None:
        space, _, name = tag.rpartition("}")
        builder.end(name if space == spaces[0] else tag)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.EntityDeclHandler = refuse_entity
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        what, place = expat.ErrorString(error.code), f"{path}:{error.lineno}:{error.offset + 1}"
        raise PluginError(f"not an XML file: {what}", where=place, hint="a robot needs a valid URDF") from None
    return builder.close(), lines


class _Source:
    """The checked content of a URDF, with the place of each element."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        root, lines = parse(path, text)
        self.places = {element: f"{path}:{line}" for element, line in lines.items()}
        """Place (file:line) of each element."""
        self.stopped: list[str] = []
        """Joints that move in a plane or freely."""
        if any(element.tag.partition("}")[0].endswith("/xacro") for element in root):  # whichever address ROS had
            hint = f"`karolos robot check {path.name} --repair robot.urdf` expands them"
            raise PluginError("macros of xacro, which are not expanded", where=str(path), hint=hint)
        if root.tag != "robot" or root.find("link") is None:
            one = f"`karolos robot check {path.name} --repair robot.urdf` writes one" if root.tag == "mujoco" else None
            if one is not None and path.suffix.lower() == ".urdf":  # by which commands know the format
                one = f"it is MJCF: call it {path.stem}.xml"
            raise PluginError("not a URDF: it needs a <robot> with links", where=str(path), hint=one)
        if len(root.findall("link")) > MOST_LINKS:
            raise PluginError(f"more than {MOST_LINKS} links", where=str(path))
        self.robot = self._checked(root)

    def error(self, element: Element, what: str, within: str = "", hint: str | None = None) -> PluginError:
        """An error at an element. It names the link or joint, or `within`."""
        place = within or f"{element.tag} {element.get('name')}"
        return PluginError(what, where=f"{self.places[element]}: {place}", hint=hint)

    def _checked(self, element: Element, above: str = "") -> Element:
        """A copy of an element with only its known content; `above` names the elements around it.

        Raises PluginError for invalid names and numbers, and for missing or doubled parts.
        """
        tag, parts = element.tag, Counter(part.tag for part in element)
        within, made = f"{above}<{tag}>", Element(tag)
        self.places[made] = self.places[element]
        if tag in ("link", "joint"):
            within = f"{tag} {self._text(element, 'name', within)}"
        for known in _KNOWN[tag].split():
            key, separator, count = known.strip("@*").partition("=")
            if known[0] == "@":
                made.set(key, self._text(element, key, within))
            elif separator and (key in element.attrib or tag in _SHAPES):
                made.set(key, self._numbers(element, key, int(count), within))
            elif parts[key] > 1 and known[-1] != "*":
                raise self.error(element, f"{parts[key]} elements <{key}> instead of one", within)
        for part in element:
            if part.tag == "color" and len(numbers(part.get("rgba", "")) or ()) != 4:
                continue  # a colour is no reason to refuse an arm
            if part.tag in _KNOWN[tag].replace("*", "").split():
                made.append(self._checked(part, "" if tag == "robot" else f"{within}: "))
        if tag in ("visual", "collision") and len(made.findall("geometry/*")) != 1:
            raise self.error(element, "it needs one shape", within, f"one of {_KNOWN['geometry'].replace(' ', ', ')}")
        return made

    def _text(self, element: Element, key: str, within: str) -> str:
        text, most = element.get(key, ""), 2000 if key == "filename" else LONGEST_NAME
        if text.isprintable() and len(text) <= most and (text.strip() or element.tag in ("material", "robot")):
            return text or ("unnamed" if element.tag == "robot" else "")
        hint = f"1 to {most} letters without control characters"
        raise self.error(element, f"its {key} is {short(text)}", within, hint)

    def _numbers(self, element: Element, key: str, count: int, within: str) -> str:
        text, least = element.get(key, ""), _LEAST.get(element.tag, -LARGEST_NUMBER)
        found = numbers(text, least)
        if found is None and element.tag == "limit" and _NUMBER.fullmatch(text.strip()):  # 1e16: exporters mean none
            return f"{LARGEST_NUMBER if float(text) > 0 else -LARGEST_NUMBER:g}"
        if found is not None and len(found) == count:
            return " ".join(text.split())
        hint = f"{count} number{'s' * (count > 1)} from {least:g} to {LARGEST_NUMBER:g}"
        raise self.error(element, f"its {key} is {short(text)}", within, hint)


def numbers(text: str, least: float = -LARGEST_NUMBER) -> list[float] | None:
    """Foreign numbers; None if a word is not a number, or is too small or too large."""
    found = [float(word) if _NUMBER.fullmatch(word) else nan for word in text.split()]
    return found if all(least <= number <= LARGEST_NUMBER for number in found) else None


def short(text: str) -> str:
    """A foreign text for messages."""
    return ascii(text if len(text) <= 60 else f"{text[:57]}...")


def read(path: Path) -> Element:
    """The content of a URDF: its links, joints and materials, checked one by one.

    Raises PluginError when the file is missing or not a URDF; it names the element and its line.
    """
    return _Source(path, text_of(path)).robot


def load(
    path: Path,
    locked: tuple[tuple[str, float], ...] = (),
    slides: tuple[str, ...] = (),
    strict: bool = True,
    driven: bool = True,
    *,
    mount: Mount | None = None,
    without: tuple[str, ...] = (),
    text: str | None = None,
) -> Description:
    """The simulated part of a URDF. The result is shared until the file changes, and must not be changed.

    Fixed joints and locked joints are merged, with the links that they move, into their parents. Elements for other
    programs (transmissions, ros2_control, gazebo, safety controllers) are left out. A continuous joint becomes a
    revolute one with `CONTINUOUS_RANGE` to each side. The range of the `slides` begins at 0, and their links weigh at
    least `FINGER_MASS`; one that mimics another has its limits where it lacks its own. Other mimics are left out.
    A link without collision shapes collides as its visuals, if it is `strict` and `driven`.

    Args:
        locked: joints that are held at a position, in rad or m. Joints that mimic one of them are held, too.
        slides: prismatic joints of a gripper.
        strict: whether to refuse limits, masses and meshes that cannot be simulated.
        driven: whether joints have motors, so that they need a largest effort and speed.
        mount: a gripper that is not in the file.
        without: joints that are left out with everything that they carry: a hand that another one replaces.
        text: of the file, if it differs from the written one.

    Raises PluginError if a joint or link is invalid or cannot be simulated; names it and its line.
    """
    texts = text_of(path) if text is None else text, text_of(mount.path) if mount else ""
    return _load(path, texts, locked, slides, (strict, driven), (mount, without))


@lru_cache(maxsize=256)
def _load(
    path: Path,
    texts: tuple[str, str],
    locked: tuple[tuple[str, float], ...],
    slides: tuple[str, ...],
    how: tuple[bool, bool],
    hand: tuple[Mount | None, tuple[str, ...]],
) -> Description:
    """`load` for files with these texts: of the robot, and of the mounted gripper."""
    (strict, driven), (mount, without) = how, hand
    source = _Source(path, texts[0])
    if without:
        locked = _cut(source.robot, without, locked)
    if mount is not None:
        _mount(source, mount, texts[1])
    robot, order = source.robot, _tree(source)
    held = _held(order, dict(locked), path)
    carriers: dict[str, str] = {}
    frames: dict[str, tuple[Array, Array]] = {}
    for element in order:
        name, parent, child = element.get("name", ""), link_of(element, "parent"), link_of(element, "child")
        carriers.setdefault(parent, parent)
        frames.setdefault(parent, (np.zeros(3), np.eye(3)))
        carriers[child], frames[child] = child, (np.zeros(3), np.eye(3))
        if name in held:
            (above, turned), (translation, rotation) = frames[parent], _placed(element, held[name])
            carriers[child], frames[child] = carriers[parent], (above + turned @ translation, turned @ rotation)
    moving = [element for element in order if element.get("name") not in held]
    if strict:
        _find_meshes(source, carriers, solid=driven)
        if len(moving) > MOST_JOINTS:
            hint = "an arm has five to eight; hold others by `locked`"
            raise PluginError(
                f"{len(moving)} moving joints; at most {MOST_JOINTS} are allowed", where=str(path), hint=hint
            )
    _merge(robot, held)
    found, named = [], {element.get("name"): element for element in moving if element.get("name") in slides}
    for element in named.values():
        mimic = element.find("mimic")
        if mimic is not None and (leader := named.get(mimic.get("joint"))) is not None:
            _mimic(element, leader, mimic)
    for element in moving:
        _make_simple(element, element.get("name") in slides)
        found.append(_joint(element, source, strict=strict, driven=driven))
    corrected = []
    if strict:
        root = carriers[link_of(order[0], "parent")] if order else robot.findall("link")[0].get("name")
        fingers = {joint.child for joint in found if joint.name in slides}
        for link in robot.findall("link"):
            name = link.get("name", "")
            if _check_link(link, source, base=name == root, least=FINGER_MASS if name in fingers else 0.0):
                corrected.append(name)
    return Description(robot, tuple(found), carriers, frames, tuple(corrected), tuple(source.stopped))


def _cut(
    robot: Element, without: tuple[str, ...], locked: tuple[tuple[str, float], ...]
) -> tuple[tuple[str, float], ...]:
    """Leave out joints with all links and joints beyond them; returns the remaining `locked` joints."""
    gone = [joint for joint in robot.findall("joint") if joint.get("name") in without]
    for joint in gone:  # which grows
        child = link_of(joint, "child")
        gone += [one for one in robot.findall("joint") if link_of(one, "parent") == child and one not in gone]
    links = {link_of(joint, "child") for joint in gone}
    for element in [*gone, *(link for link in robot.findall("link") if link.get("name") in links)]:
        robot.remove(element)
    names = {joint.get("name") for joint in gone}
    return tuple((name, position) for name, position in locked if name not in names)


def _mount(source: _Source, mount: Mount, text: str) -> None:
    """Add a gripper to an arm, its base merged into the link that carries it.

    Masses are rounded to 6 digits and positions to 1e-12 m, so that sums of decimals stay decimals.
    """
    gripper = _Source(mount.path, text)
    order = _tree(gripper)
    base = link_of(order[0], "parent") if order else gripper.robot.findall("link")[0].get("name", "")
    carrier = next((link for link in source.robot.findall("link") if link.get("name") == mount.link), None)
    if carrier is None:
        raise PluginError(f"there is no link {mount.link!r} to mount a gripper on", where=str(source.path))
    _find_meshes(gripper, {}, solid=False)
    keys = dict.fromkeys(("link", "joint", "material"), "name")
    keys |= {"parent": "link", "child": "link", "mimic": "joint"}
    for element in gripper.robot.iter():
        if (key := keys.get(element.tag)) is not None and (name := element.get(key)):
            element.set(key, mount.named(name))
    joint = Element("joint", name=mount.named("mount"), type="fixed")
    for tag, link in (("parent", mount.link), ("child", mount.named(base))):
        ElementTree.SubElement(joint, tag, link=link)
    _set_origin(joint, np.array(mount.position), rotation_matrix(*mount.rpy))
    moved = [one for one in gripper.robot.findall("joint") if link_of(one, "parent") == mount.named(base)]
    moved += [
        shape
        for link in gripper.robot.findall("link")
        if link.get("name") == mount.named(base)
        for shape in [*link.findall("visual"), *link.findall("collision")]
    ]
    source.robot.extend([*gripper.robot, joint])
    source.places |= gripper.places
    _merge(source.robot, {mount.named("mount"): 0.0})
    for element in moved:
        for origin in element.findall("origin"):
            place = (round(float(value), 12) + 0.0 for value in origin.get("xyz", "").split())
            origin.set("xyz", " ".join(map(repr, place)))
    mass, centre, tensor = inertia_of(carrier)
    _set_inertia(carrier, _six(mass), np.vectorize(_six)(centre), np.vectorize(_six)(tensor))


def _six(value: float) -> float:
    """A mass, length or inertia in 6 digits."""
    return float(f"{value:.6g}") if abs(value) > LEAST_INERTIA else 0.0


def _tree(source: _Source) -> list[Element]:
    """The joints from the base outwards, each after the joint of its parent. Raises PluginError if it is not a tree."""
    known: dict[tuple[str, str], Element] = {}
    for element in source.robot:
        if (
            element.tag != "material"
            and known.setdefault((element.tag, element.get("name", "")), element) is not element
        ):
            raise source.error(element, "two of this name")
    above: dict[str, Element] = {}
    below: dict[str, list[Element]] = defaultdict(list)
    elements = source.robot.findall("joint")
    for element in elements:
        kind, ends = element.get("type"), (link_of(element, "parent"), link_of(element, "child"))
        if kind in {"planar", "floating"}:  # of a mobile base: the arm stands still on it
            source.stopped.append(element.get("name", ""))
            element.set("type", kind := "fixed")
        if kind not in {"revolute", "continuous", "prismatic", "fixed"}:
            raise source.error(element, f"a {kind} joint", hint="joints are revolute, continuous, prismatic or fixed")
        if element.find("parent") is None or element.find("child") is None:
            raise source.error(element, "a joint without parent or child")
        for link in ends:
            if ("link", link) not in known:
                raise source.error(element, f"there is no link {link!r}")
        if ends[1] in above:
            other = above[ends[1]].get("name")
            raise source.error(element, f"link {ends[1]!r} is also the child of joint {other}")
        above[ends[1]] = element
        below[ends[0]].append(element)
    roots = [name for tag, name in known if tag == "link" and name not in above]
    if len(roots) != 1:
        some = ", ".join(roots[:5]) or "the joints form a circle"
        what = f"{len(roots)} links without a joint above them: {some}"
        raise PluginError(what, where=str(source.path), hint="exactly one link is the base")
    order, reached = [], roots
    while reached:
        further = below[reached[0]]
        order += further
        reached = [*(link_of(element, "child") for element in further), *reached[1:]]
    if len(order) < len(elements):
        circle = {*elements}.difference(order)
        raise source.error(next(one for one in elements if one in circle), "not connected to the base")
    return order


def _held(order: Iterable[Element], locked: dict[str, float], path: Path) -> dict[str, float]:
    """The position of every joint that does not move: fixed and locked joints, and joints that mimic a locked one."""
    held = {element.get("name", ""): 0.0 for element in order if element.get("type") == "fixed"}
    names = [element.get("name", "") for element in order]
    for name in locked:
        if name not in names:
            raise PluginError(f"no joint is called {name!r}", where=str(path), hint=f"joints: {', '.join(names)}")
    held.update(locked)
    mimics = {element.get("name", ""): one for element in order if (one := element.find("mimic")) is not None}
    while ready := [name for name, one in mimics.items() if name not in held and one.get("joint") in held]:
        for name in ready:  # a mimic joint may follow another
            factor, offset = (float(mimics[name].get(key, usual)) for key, usual in (("multiplier", 1), ("offset", 0)))
            held[name] = held[mimics[name].get("joint", "")] * factor + offset
    return held


def _mimic(element: Element, leader: Element, mimic: Element) -> None:
    """Give a finger that mimics another one the limits that it lacks, which exporters write only for the motor.

    If its own limits let it slide in the direction of the other, a negative multiplier turns it.
    """
    limit, other = element.find("limit"), leader.find("limit")
    if other is None:
        return
    if limit is None:
        limit = ElementTree.SubElement(element, "limit")
    for key in ("effort", "velocity"):
        if float(limit.get(key, "0")) <= 0 and key in other.attrib:
            limit.set(key, other.get(key, ""))
    factor, offset = (float(mimic.get(key, usual)) for key, usual in (("multiplier", "1"), ("offset", "0")))
    sign = -1 if factor < 0 else 1
    lacks = not float(limit.get("lower", "0")) < float(limit.get("upper", "0"))
    if factor and (lacks or (sign < 0 and _way(element) @ _way(leader) > 0)):
        axis = element.find("axis")
        if axis is None:
            axis = ElementTree.SubElement(element, "axis")
        axis.set("xyz", " ".join(repr(sign * value) for value in _axis(element)))
        for key in ("lower", "upper"):
            limit.set(key, repr(abs(factor) * float(other.get(key, "0")) + sign * offset))


def _way(element: Element) -> Array:
    """The direction (3,) in which a slide moves away from 0, in its parent's frame."""
    limit, (_, rotation) = element.find("limit"), origin_of(element)
    lower, upper = (float(limit.get(key, "0")) if limit is not None else 0.0 for key in ("lower", "upper"))
    way: Array = rotation @ _axis(element)
    return -way if -lower > upper else way


def _make_simple(element: Element, slide: bool) -> None:
    """Convert a continuous joint to a revolute one, and shift the range of a gripper's slide so that it begins at 0."""
    limit = element.find("limit")
    if limit is None and element.get("type") == "continuous":  # which needs none
        limit = ElementTree.SubElement(element, "limit")
    if limit is None:
        return
    limit.attrib = {"lower": "0", "upper": "0"} | limit.attrib  # as the format says
    if element.get("type") == "continuous":
        element.set("type", "revolute")
        limit.set("lower", repr(-CONTINUOUS_RANGE))
        limit.set("upper", repr(CONTINUOUS_RANGE))
    if slide:
        lower, upper, axis = float(limit.get("lower", "0")), float(limit.get("upper", "0")), np.array(_axis(element))
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


def _joint(element: Element, source: _Source, *, strict: bool, driven: bool) -> Joint:
    limit, mimic, dynamics = element.find("limit"), element.find("mimic"), element.find("dynamics")
    if mimic is not None:
        element.remove(mimic)
    # engines treat friction differently, and one ignores it
    friction = float(dynamics.attrib.pop("friction", "0")) if dynamics is not None else 0.0
    values = limit.attrib if limit is not None else {}
    if limit is not None and not driven:  # engines need them
        limit.attrib.update(effort="1000", velocity="1000")
    lower, upper, effort, velocity = (float(values.get(key, nan if strict else 0)) for key in _LIMITS)
    axis, effort = _axis(element), effort - friction
    if not any(axis):
        raise source.error(element, "its axis is 0 0 0")
    if strict and not (lower < upper and effort > 0 and velocity > 0):
        what = "limits must satisfy lower < upper" + f", effort > {friction:g}, velocity > 0" * driven
        hint = "write the numbers of the data sheet into <limit>; exporters leave zeros"
        raise source.error(element, what, hint=hint)
    origin, rotation = origin_of(element)
    return Joint(
        name=element.get("name", ""),
        parent=link_of(element, "parent"),
        child=link_of(element, "child"),
        revolute=element.get("type") != "prismatic",
        origin=vector(origin),
        rotation=tuple(vector(row) for row in rotation),
        axis=axis,
        lower=lower,
        upper=upper,
        effort=effort,
        velocity=velocity,
        mimic=None if mimic is None else mimic.get("joint"),
        friction=friction,
    )


def drawn_links(robot: Element, carriers: Mapping[str, str]) -> set[str]:
    """The links whose visuals are only drawn: others collide as their visuals.

    These are links with a collision shape, of their own or of a link that is merged with them, and markers: frames
    without mass.
    """
    links = {link.get("name", ""): link for link in robot.findall("link")}
    bodies = {name: carriers.get(name, name) for name in links}
    solid = {bodies[name] for name, link in links.items() if link.find("collision") is not None}
    frames = {name for name, link in links.items() if bodies[name] != name and link.find("inertial") is None}
    return frames | {name for name in links if bodies[name] in solid}


def _find_meshes(source: _Source, carriers: Mapping[str, str], *, solid: bool) -> None:
    """Give every mesh its absolute file name. Leave out visuals in Collada that are only drawn.

    `solid`: whether the links that are not among the `drawn_links` collide as their visuals.
    """
    drawn = drawn_links(source.robot, carriers)
    for link in source.robot.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            for mesh in shape.iter("mesh"):
                name = mesh.get("filename", "")
                if shape.tag == "visual" and name.lower().endswith(".dae") and link.get("name") in drawn:
                    link.remove(shape)
                    continue
                found = find_named(name, source.path.parent)
                if found is None:
                    hint = "it is looked for beside the URDF and in folders above"
                    raise source.error(link, f"there is no mesh {short(name)}", hint=hint)
                if found.suffix.lower() not in MESH_SUFFIXES:
                    hint = f"meshes end in {', '.join(MESH_SUFFIXES)}"
                    raise source.error(link, f"cannot read the mesh {short(name)}", hint=hint)
                check_size(found, [float(one) for one in mesh.get("scale", "1 1 1").split()])
                mesh.set("filename", str(found))
        for shape in link.findall("visual") if solid and link.get("name") not in drawn else ():
            if not any(is_flat(Path(mesh.get("filename", ""))) for mesh in shape.iter("mesh")):  # a label
                parts = [part for part in shape if part.tag != "material"]
                ElementTree.SubElement(link, "collision").extend(copy.deepcopy(parts))


def _check_link(link: Element, source: _Source, *, base: bool, least: float) -> bool:
    """Check the mass and the inertia of a link. Returns whether the inertia had to be corrected.

    Args:
        base: whether the link is fixed and needs no mass.
        least: smallest mass in kg; a smaller one is raised to it, and the inertia with it.
    """
    mass, centre, tensor = inertia_of(link)
    moments, axes = np.linalg.eigh(tensor)
    if base:
        if link.find("inertial") is None or moments[0] < 0:  # an engine would guess, or refuse it
            _set_inertia(link, 1.0, centre, np.eye(3))
        return False
    if mass < LEAST_SIZE:
        raise source.error(link, "it moves and has no mass", hint="write its <inertial>")
    if moments[0] < LEAST_INERTIA:
        raise source.error(link, "its inertia is not positive definite", hint="correct its <inertial>")
    if mass < least:
        mass, tensor = least, tensor * (least / mass)
        moments, axes = np.linalg.eigh(tensor)
        _set_inertia(link, mass, centre, tensor)
    missing = 1.001 * moments[2] - moments[0] - moments[1]  # engines set the inertia to 0, or refuse it
    if missing <= 0.001 * moments[2]:
        return False
    _set_inertia(link, mass, centre, axes @ np.diag(moments + np.array([missing / 2, missing / 2, 0.0])) @ axes.T)
    return True


def _axis(joint: Element) -> Vector:
    """The axis with length 1; all 0 if the axis is too short to have a direction."""
    axis = joint.find("axis")
    found = vector((axis.get("xyz", "1 0 0") if axis is not None else "1 0 0").split())
    length = hypot(*found)
    if length < LEAST_SIZE:
        return 0.0, 0.0, 0.0
    return found if length == 1 else vector(np.divide(found, length))


def origin_of(element: Element) -> tuple[Array, Array]:
    """Translation (3,) and rotation (3, 3) of an element's <origin>."""
    origin = element.find("origin")
    if origin is None:
        return np.zeros(3), np.eye(3)
    translation = np.array(vector(origin.get("xyz", "0 0 0").split()))
    return translation, rotation_matrix(*vector(origin.get("rpy", "0 0 0").split()))


def _placed(joint: Element, position: float) -> tuple[Array, Array]:
    """Translation (3,) and rotation (3, 3) of a joint's child in its parent's frame, at a position in rad or m."""
    translation, rotation = origin_of(joint)
    if joint.get("type") == "prismatic":
        return translation + rotation @ np.array(_axis(joint)) * position, rotation
    return translation, rotation @ about(_axis(joint), position) if position else rotation


def weld(robot: Element, positions: Mapping[str, float]) -> Element:
    """A copy with the named joints fixed at these positions and their links merged into their parents.

    A link costs about a tenth of an arm's physics step. Therefore a gripper that a task never moves is not simulated.
    """
    robot = copy.deepcopy(robot)
    _merge(robot, positions)
    return robot


def _merge(robot: Element, positions: Mapping[str, float]) -> None:
    """`weld` in place."""
    links = {link.get("name"): link for link in robot.findall("link")}
    below: dict[str, list[Element]] = defaultdict(list)
    for element in robot.findall("joint"):
        below[link_of(element, "parent")].append(element)
    for element in robot.findall("joint"):
        position = positions.get(element.get("name", ""))
        if position is None:
            continue
        parent, child = (links[link_of(element, role)] for role in ("parent", "child"))
        translation, rotation = _placed(element, position)
        _merge_inertia(parent, child, translation, rotation)
        for shape in [*child.findall("visual"), *child.findall("collision")]:
            _move(shape, translation, rotation)
            parent.append(shape)
        for other in below[child.get("name", "")]:
            _move(other, translation, rotation)
            other.findall("parent")[0].set("link", parent.get("name", ""))
            below[parent.get("name", "")].append(other)
        robot.remove(element)
        robot.remove(child)


def about(axis: Vector, angle: float) -> Array:
    """Rotation (3, 3) by an angle in rad about an axis of length 1 (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation: Array = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return rotation


def _move(element: Element, translation: Array, rotation: Array) -> None:
    """Express the <origin> of an element in the frame around its own frame."""
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


def inertia_of(link: Element) -> tuple[float, Array, Array]:
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
    parts = [inertia_of(parent)]
    mass, centre, tensor = inertia_of(child)
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
