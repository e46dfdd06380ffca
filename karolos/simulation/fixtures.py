"""Fixtures and objects with joints, read from a URDF or MJCF file. Each name and number is checked.

Known elements of MJCF, all others are refused: <mujoco> with <compiler angle meshdir assetdir>, <asset> with <mesh name
file scale>, <default> with classes, and one <body> in <worldbody>, which is the base. A body has name, pos, quat or
euler, childclass, further bodies, at most one <joint> (name, type hinge or slide, pos, axis, range, damping,
frictionloss), at most one <inertial> (pos, quat, mass, diaginertia or fullinertia), and <geom> (type, size, pos, quat
or euler, fromto, mesh, mass or density). Parts that are only drawn or measured are left out: geoms with contype and
conaffinity 0, materials, cameras, lights, sites, sensors, options. A link has the name of its joint. Without an
<inertial>, its inertia is that of its geoms, each with its own mass. As in MuJoCo, geoms that are only drawn also have
a mass.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from ..core import Array
from ..errors import PluginError, UsageError
from . import meshes, urdf
from .geometry import Quaternion, matrix_of, quaternion_of, vector
from .parts import GREY, Link, Mechanism, link_element, mechanism, place_element
from .shapes import Capsule, Cuboid, Cylinder, Inertia, Mesh, Shape, Sphere, inertia_of, volume_of

_LEFT_OUT = {
    *("option", "visual", "statistic", "size", "sensor", "camera", "light", "site", "keyframe", "custom", "material"),
    "texture",
}
_ATTRIBUTES = {
    "mujoco": "model",
    "compiler": "angle meshdir assetdir texturedir autolimits discardvisual usethread",
    "asset": "",
    "worldbody": "",
    "default": "class",
    "mesh": "name class file scale smoothnormal maxhullvert",
    "body": "name childclass pos quat euler",
    "joint": "name class type pos axis range limited damping frictionloss",
    "inertial": "pos quat mass diaginertia fullinertia",
    "geom": "name class type size pos quat euler fromto mesh mass density rgba material friction group condim contype "
    "conaffinity",
}
"""Known attributes and parts of each element of MJCF."""
DENSITY = 1000.0
"""Density in kg/m3 of a geom in MJCF without a mass."""
_ACTUATORS = {"general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder", "muscle", "adhesion"}
"""Elements that share their defaults in MJCF."""
_TURNS = ("quat", "euler", "axisangle", "xyaxes", "zaxis")
"""Attributes that give an orientation in MJCF."""
_LOST = {"include", "replicate", "attach", "composite", "flexcomp"}
"""Elements of MJCF that make bodies."""
ONE_FILE = "mujoco writes one file: s = mujoco.MjSpec.from_file(FILE); s.compile(); s.to_xml()"


def read(path: Path, collision: meshes.Collision | None = None) -> Mechanism:
    """A fixture or an object with joints from a URDF or MJCF file.

    Args:
        collision: collision shapes of its meshes; by default their hulls, with a warning if a hull fills a hole.

    Raises:
        PluginError: the file holds an element that karolos does not know or cannot simulate; names element and line.
    """
    root, lines = urdf.parse(path, urdf.text_of(path))
    if root.tag == "mujoco":
        return mechanism(list(_MjcfReader(path, collision, root, lines).links()))
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
    """The URDF of an arm in an MJCF file, with absolute names of meshes. Elements unknown to fixtures are left out.

    Its torques are those of its actuators, or limits of its joints; MJCF has no speeds.

    Args:
        speed: of turning joints, in rad/s.
        slide: the same of sliding joints, in m/s.

    Raises PluginError if it is not an MJCF file of one arm. The message names element and line.
    """
    root, lines = urdf.parse(path, urdf.text_of(path))
    if root.tag != "mujoco":
        raise PluginError("not an MJCF file", where=str(path), hint="its root is <mujoco>")
    reader = _MjcfArm(path, "convex", root, lines)
    reader.robot = Element("robot", name=root.get("model", "arm"))
    list(reader.links())
    torques: dict[str, float] = {}
    for actuator in root.iterfind("actuator/*"):
        reader.complete_actuator(actuator)
        limits = actuator.get("forcerange") or (actuator.get("ctrlrange") if actuator.tag == "motor" else None)
        gear = (urdf.numbers(actuator.get("gear", "1")) or [1.0])[0]
        torques[actuator.get("joint", "")] = max(map(abs, urdf.numbers(limits or "0") or [0.0])) * abs(gear)
    for joint in reader.robot.iterfind("joint"):
        for limit in joint.findall("limit"):
            limit.set("velocity", repr(slide if joint.get("type") == "prismatic" else speed))
            if torque := torques.get(joint.get("name", "")):
                limit.set("effort", repr(torque))
    return reader.robot


class _MjcfReader:
    """Reads the links of an MJCF file."""

    _bodies = "body"
    """Elements that hold shapes and further bodies."""

    def __init__(
        self, path: Path, collision: meshes.Collision | None, root: Element, lines: dict[Element, int]
    ) -> None:
        self._path, self._collision, self._root, self._lines = path, collision, root, lines
        self._files: dict[str, tuple[Path, float] | PluginError] = {}
        """Files of meshes and their scales; an error counts only if a shape needs the mesh."""
        self._degree, self._sequence = np.pi / 180, "xyz"
        self._usual: dict[str, dict[str, dict[str, str]]] = {"main": {}}
        """Default attributes of elements: by class, and by kind of element."""

    def links(self) -> Iterator[Link]:
        """The base, then the links, each after its parent."""
        bodies: list[Element] = []
        folder = self._path.parent
        for default in self._root.findall("default"):
            self._learn(default, "main", {})
        for part in self._parts(self._root, "compiler default asset worldbody"):
            if part.tag == "compiler":
                folder = self._path.parent / part.get("meshdir", part.get("assetdir", folder))
                self._degree = {"radian": 1.0, "degree": np.pi / 180}.get(part.get("angle", ""), self._degree)
                self._sequence = part.get("eulerseq", self._sequence)
                if len(self._sequence) != 3 or not {*self._sequence} <= {*"xyzXYZ"}:
                    raise self._error(part, f"its eulerseq is {urdf.short(self._sequence)}", "three of xyzXYZ")
            for mesh in self._parts(part, "mesh") if part.tag == "asset" else ():
                self._complete(mesh, "main")
                file, scale = folder / mesh.get("file", ""), self._numbers(mesh, "scale", (1.0, 1.0, 1.0))
                usable = file.is_file() and file.suffix.lower() in meshes.MESH_SUFFIXES and not np.ptp(scale)
                usable = usable and not {"refpos", "refquat"} & mesh.attrib.keys()
                needs = f"it needs a file of {', '.join(meshes.MESH_SUFFIXES)}, one scale for all axes, and no refpos"
                found = (file, float(scale[0])) if usable else self._error(mesh, needs)
                self._files[mesh.get("name", file.stem)] = found
            bodies += self._parts(part, self._bodies) if part.tag == "worldbody" else []
        yield from self._body(self._base(bodies), "", np.zeros(3), "main")

    def _base(self, bodies: Sequence[Element]) -> Element:
        """The base among the bodies of the world. Raises PluginError if there is not one."""
        if len(bodies) != 1:
            raise self._error(self._root, f"{len(bodies)} bodies in <worldbody>; it needs one, the base")
        return bodies[0]

    def _learn(self, default: Element, name: str, above: dict[str, dict[str, str]]) -> None:
        """Keep the attributes of a class, which inherits those of the class around it."""
        own = {tag: dict(values) for tag, values in (self._usual.get(name) or above).items()}
        for part in default:
            if part.tag in ("geom", "joint", "mesh"):
                self._parts(part, "")
                own.setdefault(part.tag, {}).update(part.attrib)
            elif part.tag in _ACTUATORS:
                own.setdefault("actuator", {}).update(part.attrib)
        self._usual[name] = own
        for part in default.findall("default"):
            self._learn(part, part.get("class", ""), own)

    def _complete(self, element: Element, usual: str) -> None:
        """Give an element the attributes of its class, or of the class `usual`."""
        name = element.get("class", usual)
        if name not in self._usual:
            raise self._error(element, f"there is no class {urdf.short(name)}")
        turned = any(key in element.attrib for key in _TURNS)
        for key, value in self._usual[name].get(element.tag, {}).items():
            if not (turned and key in _TURNS):
                element.attrib.setdefault(key, value)

    def _body(self, body: Element, parent: str, offset: Array, usual: str) -> Iterator[Link]:
        """A body and all on it. A link's frame is at its joint; `offset` (3,) is the parent's frame in its body."""
        parts, usual = self._parts(body, "joint inertial geom body"), body.get("childclass", usual)
        for part in parts:
            self._complete(part, usual)
        joints, inertials = ([part for part in parts if part.tag == tag] for tag in ("joint", "inertial"))
        if len(joints) != bool(parent) or len(inertials) > 1:
            raise self._error(body, "a moving body needs one joint, the base none, and each at most one <inertial>")
        joint = joints[0] if joints else Element("joint", range="0 0")
        name, turns = joint.get("name", body.get("name", "base")), joint.get("type", "hinge") == "hinge"
        unlimited = "range" not in joint.attrib or joint.get("limited") == "false"
        if unlimited or joint.get("type", "hinge") not in ("hinge", "slide"):
            raise self._error(joint, "it needs the type hinge or slide and a range")
        place, turn = self._pose(body)
        pivot = self._numbers(joint, "pos", (0.0, 0.0, 0.0))
        low, high = self._numbers(joint, "range", (0.0, 0.0)) * (self._degree if turns else 1.0)
        inertia, shapes, solids, masses = None, list[Shape](), list[Shape](), list[float]()
        for geom in parts:
            drawn = (geom.get("contype"), geom.get("conaffinity")) == ("0", "0")
            if geom.tag == "geom" and not (drawn and (inertials or not parent)):
                shape = self._shape(geom, pivot, "convex" if drawn else self._collision)
                shapes += [shape] * (not drawn)
                density = self._number(geom, "density", DENSITY)
                masses.append(self._number(geom, "mass", density * volume_of([shape])))
                solids.append(shape)
        mass = sum(masses)
        if mass and parent and not inertials:
            inertia = inertia_of(solids, mass, masses)
        for inertial in inertials:
            mass, inertia = self._inertial(inertial, pivot)
        yield Link(
            name=name,
            shapes=shapes,
            mass=mass if parent else 0.0,
            inertia=inertia if parent else None,
            parent=parent,
            joint="hinge" if turns else "slide",
            axis=vector(self._numbers(joint, "axis", (0.0, 0.0, 1.0))),
            range=(float(low), float(high)),
            friction=self._number(joint, "frictionloss", 0.0),
            damping=self._number(joint, "damping", 0.0),
            position=vector(place - offset + matrix_of(turn) @ pivot),
            orientation=turn,
        )
        for part in parts:
            if part.tag == "body":
                yield from self._body(part, name, pivot, usual)

    def _inertial(self, inertial: Element, pivot: Array) -> tuple[float, Inertia]:
        """Mass and inertia of an <inertial> in the frame at `pivot` (3,) of its body."""
        centre, axes = self._pose(inertial)
        moments = self._numbers(inertial, "diaginertia", (0.0,) * 3)
        if "fullinertia" in inertial.attrib:
            a, b, c, d, e, f = self._numbers(inertial, "fullinertia", (0.0,) * 6)
            moments, turn = np.linalg.eigh([[a, d, e], [d, b, f], [e, f, c]])
            axes = quaternion_of(matrix_of(axes) @ turn * np.sign(np.linalg.det(turn)))
        return self._number(inertial, "mass", 0.0), Inertia(vector(centre - pivot), vector(moments), axes)

    def _shape(self, geom: Element, pivot: Array, collision: meshes.Collision | None) -> Shape:
        """The shape of a geom in the frame at `pivot` (3,) of its body."""
        place, turn = self._pose(geom)
        kind, size = geom.get("type", "sphere"), self._numbers(geom, "size", ())
        if "fromto" in geom.attrib:
            ends = self._numbers(geom, "fromto", (0.0,) * 6).reshape(2, 3)
            place, along = ends.mean(0), ends[1] - ends[0]
            size = np.append(size[:1], np.linalg.norm(along) / 2)
            turn = _from_z(along)
        pose: dict[str, Any] = {"position": vector(place - pivot), "orientation": turn}
        if kind == "mesh" and geom.get("mesh") in self._files:
            found = self._files[geom.get("mesh", "")]
            if isinstance(found, PluginError):
                raise found
            return Mesh(*found, collision, **pose)
        half = [float(one) for one in size]
        try:
            match kind, half:
                case "box", [x, y, z]:
                    return Cuboid((2 * x, 2 * y, 2 * z), **pose)
                case "sphere", [radius]:
                    return Sphere(radius, **pose)
                case "cylinder", [radius, length]:
                    return Cylinder(radius, 2 * length, **pose)
                case "capsule", [radius, length]:
                    return Capsule(radius, 2 * length, **pose)
        except UsageError as error:
            raise self._error(geom, str(error)) from None
        raise self._error(geom, f"type {kind!r} with {len(half)} sizes: box 3, sphere 1, cylinder and capsule 2, mesh")

    def _pose(self, element: Element) -> tuple[Array, Quaternion]:
        """Position (3,) and rotation of an element."""
        w, x, y, z = self._numbers(element, "quat", (1.0, 0.0, 0.0, 0.0)).tolist()
        if "euler" in element.attrib:  # MuJoCo's order: about x, then the new y, then the new z
            turn = np.eye(3)
            for angle, name in zip(self._numbers(element, "euler", (0.0,) * 3), self._sequence, strict=True):
                one = urdf.about(vector(np.eye(3)["xyz".index(name.lower())]), angle * self._degree)
                turn = turn @ one if name.islower() else one @ turn  # capitals: about the axes of the parent
            x, y, z, w = quaternion_of(turn)
        elif "axisangle" in element.attrib:
            *axis, angle = self._numbers(element, "axisangle", (0.0, 0.0, 1.0, 0.0))
            length = float(np.linalg.norm(axis)) or 1.0
            x, y, z, w = quaternion_of(urdf.about(vector(np.divide(axis, length)), angle * self._degree))
        elif "xyaxes" in element.attrib:
            ahead, across = self._numbers(element, "xyaxes", (0.0,) * 6).reshape(2, 3)
            x, y, z, w = self._turned(element, np.cross(ahead, across), ahead)
        elif "zaxis" in element.attrib:  # MuJoCo's: the shortest turn from z
            along = self._numbers(element, "zaxis", (0.0,) * 3)
            x, y, z, w = -along[1], along[0], 0.0, along[2] + float(np.linalg.norm(along))
            x, y, z, w = (x, y, z, w) if any((x, y, w)) else (1.0, 0.0, 0.0, 0.0)
        if not any((w, x, y, z)):
            raise self._error(element, "its quat is 0")
        return self._numbers(element, "pos", (0.0, 0.0, 0.0)), (x, y, z, w)

    def _turned(self, element: Element, z: Array, x: Array) -> Quaternion:
        """The rotation with these directions of z and x. Raises PluginError if they are parallel or 0."""
        if not (np.linalg.norm(z) > 0 and np.linalg.norm(x) > 0):
            raise self._error(element, "its xyaxes are parallel, or 0")
        ahead, up = x / np.linalg.norm(x), z / np.linalg.norm(z)
        return quaternion_of(np.column_stack([ahead, np.cross(up, ahead), up]))

    def _number(self, element: Element, key: str, usual: float) -> float:
        return float(self._numbers(element, key, (usual,))[0])

    def _numbers(self, element: Element, key: str, usual: tuple[float, ...]) -> Array:
        """The numbers of an attribute, in the usual count; 1 to 3 for ()."""
        if key not in element.attrib:
            return np.array(usual)
        found = urdf.numbers(element.get(key, ""))
        if found is None or len(found) not in ((len(usual),) if usual else (1, 2, 3)):
            raise self._error(element, f"its {key} is {urdf.short(element.get(key, ''))}")
        return np.array(found)

    def _parts(self, element: Element, known: str) -> list[Element]:
        """The parts of an element. Raises PluginError for unknown parts and attributes."""
        strange = [key for key in element.attrib if key not in _ATTRIBUTES[element.tag].split()]
        parts = [part for part in element if part.tag not in _LEFT_OUT]
        for part in parts:
            if part.tag not in known.split():
                raise self._error(part, f"<{part.tag}> in <{element.tag}> is not known to karolos")
            if part.tag in ("geom", "joint", "inertial", "compiler", "mesh"):
                self._parts(part, "")
        if strange:
            raise self._error(element, f"{', '.join(strange)} is not known to karolos")
        return parts

    def _error(
        self, element: Element, what: str, hint: str = "docs/parts.md lists what of MJCF is known; a URDF may say more"
    ) -> PluginError:
        place = f"{self._path}:{self._lines.get(element, 0)}: {element.tag} {element.get('name', '')}".strip()
        return PluginError(what, where=place, hint=hint)


class _MjcfArm(_MjcfReader):
    """Reads an arm. Bodies without a joint are frames or parts of the body before; unknown parts are left out."""

    robot: Element
    """What `links` fills."""
    _bodies = "body frame"

    def _base(self, bodies: Sequence[Element]) -> Element:
        if not bodies:
            included = self._root.find(".//include") is not None
            what = f"no bodies in <worldbody>{', but an <include>' * included}"
            raise self._error(self._root, what, ONE_FILE if included else "an arm is a tree of bodies")
        first, *others = bodies
        placed = any(key in first.attrib for key in ("pos", *_TURNS)) or first.find("joint") is not None
        if not others and not placed:
            return first
        world = Element("body", name="world")  # of two arms side by side the user chooses one by its tool
        world.extend(bodies)
        return world

    def complete_actuator(self, actuator: Element) -> None:
        """Give an actuator the attributes of its class."""
        for key, value in self._usual.get(actuator.get("class", "main"), {}).get("actuator", {}).items():
            actuator.attrib.setdefault(key, value)

    def _body(self, body: Element, parent: str, offset: Array, usual: str) -> Iterator[Link]:
        parts, usual = self._parts(body, f"joint inertial geom {self._bodies}"), body.get("childclass", usual)
        for part in parts:
            self._complete(part, usual)
        for part in body:
            if part.tag in _LOST:
                raise self._error(part, f"<{part.tag}> in <{body.tag}> is not known to karolos", ONE_FILE)
            if part.tag == "inertial":  # then shapes have no mass, nor have those of frames
                for geom in (geom for frame in body.findall("frame") for geom in _shapes_of(frame)):
                    geom.set("mass", "0")
        joints = [part for part in parts if part.tag == "joint" and part.get("type") != "free"]
        if len(joints) > 1 or (joints and body.tag == "frame"):
            raise self._error(body, f"one {body.tag} has {len(joints)} joints", "a body of an arm has one joint")
        pivot = self._numbers(joints[0], "pos", (0.0, 0.0, 0.0)) if joints else np.zeros(3)
        name, (place, turn) = body.get("name", f"body{len(self.robot)}"), self._pose(body)
        self._add_link(name, parts, pivot)
        if parent:
            title = joints[0].get("name", f"{name}_joint") if joints else f"{name}_fixed"
            made = SubElement(self.robot, "joint", name=title, type="fixed")
            SubElement(made, "parent", link=parent)
            SubElement(made, "child", link=name)
            origin = place - offset + matrix_of(turn) @ pivot
            for joint in joints:
                origin, turn = self._move(made, joint, origin, turn)
            place_element(made, vector(origin), turn)
        for part in parts:
            if part.tag in self._bodies.split():
                yield from self._body(part, name, pivot, usual)

    def _add_link(self, name: str, parts: Sequence[Element], pivot: Array) -> None:
        """Add the link of a body with these parts. Its frame is at `pivot` (3,) of the body."""
        drawn = [geom for geom in parts if geom.tag == "geom"]
        solid = [geom for geom in drawn if (geom.get("contype"), geom.get("conaffinity")) != ("0", "0")] or drawn
        inertials, mass, inertia = [part for part in parts if part.tag == "inertial"], 0.0, None
        with warnings.catch_warnings():
            if inertials:  # then no hull determines a mass
                warnings.simplefilter("ignore")
            shapes = [self._shape(geom, pivot, "convex") for geom in solid]
        solids, masses = list[Shape](), list[float]()
        for geom in () if inertials else drawn:
            if geom in solid or not isinstance(self._files.get(geom.get("mesh", "")), PluginError):
                solids.append(shapes[solid.index(geom)] if geom in solid else self._shape(geom, pivot, "convex"))
                density = self._number(geom, "density", DENSITY)
                masses.append(self._number(geom, "mass", density * volume_of(solids[-1:])))
        if (mass := sum(masses)) > 0:
            inertia = inertia_of(solids, mass, masses)
        for inertial in inertials:
            mass, inertia = self._inertial(inertial, pivot)
        self.robot.append(link_element(name, shapes, mass, inertia, GREY))

    def _move(self, made: Element, joint: Element, origin: Array, turn: Quaternion) -> tuple[Array, Quaternion]:
        """Make a fixed joint of the URDF this joint. Returns its origin at position 0: the file has it at `ref`."""
        kind = {"hinge": "revolute", "slide": "prismatic"}.get(joint.get("type", "hinge"))
        if kind is None:
            raise self._error(joint, f"a {joint.get('type')} joint", "joints of an arm are hinges and slides")
        made.set("type", kind)
        scale = self._degree if kind == "revolute" else 1.0
        if joint.get("limited") == "false":
            joint.attrib.pop("range", None)
        low, high = (self._numbers(joint, "range", (-2 * np.pi / scale, 2 * np.pi / scale)) * scale).tolist()
        axis = self._numbers(joint, "axis", (0.0, 0.0, 1.0))
        SubElement(made, "axis", xyz=" ".join(map(repr, axis.tolist())))
        torque = self._numbers(joint, "actuatorfrcrange", (0.0, 0.0))
        SubElement(made, "limit", lower=repr(low), upper=repr(high), effort=repr(float(np.abs(torque).max())))
        damping, friction = (self._number(joint, key, 0.0) for key in ("damping", "frictionloss"))
        SubElement(made, "dynamics", damping=repr(damping), friction=repr(friction))
        back = -scale * self._number(joint, "ref", 0.0)
        if not back or not axis.any():
            return origin, turn
        along = axis / np.linalg.norm(axis)
        if kind == "prismatic":
            return origin + matrix_of(turn) @ along * back, turn
        return origin, quaternion_of(matrix_of(turn) @ urdf.about(vector(along), back))

    def _parts(self, element: Element, known: str) -> list[Element]:
        return [part for part in element if part.tag in known.split()]


def _shapes_of(frame: Element) -> Iterator[Element]:
    """The shapes of a frame and of all frames in it."""
    yield from frame.findall("geom")
    for inner in frame.findall("frame"):
        yield from _shapes_of(inner)


def _from_z(along: Array) -> Quaternion:
    """A rotation that turns the z axis in this direction."""
    ahead = along / np.linalg.norm(along)
    across = np.cross(ahead, np.eye(3)[np.argmin(np.abs(ahead))])
    across /= np.linalg.norm(across)
    return quaternion_of(np.column_stack([across, np.cross(ahead, across), ahead]))
