"""Fixtures and objects with joints, read from a URDF or MJCF file. Each name and number is checked.

Known elements of MJCF, all others are refused: <mujoco> with <compiler angle meshdir assetdir>, <asset> with <mesh name
file scale>, <default> with classes, and one <body> in <worldbody>, which is the base. A body has name, pos, quat or
euler, childclass, further bodies, at most one <joint> (name, type hinge or slide, pos, axis, range, damping,
frictionloss), at most one <inertial> (pos, quat, mass, diaginertia), and <geom> (type, size, pos, quat or euler,
fromto, mesh, mass or density). Parts that are only drawn or measured are left out: geoms with contype and conaffinity
0, materials, cameras, lights, sites, sensors, options. A link has the name of its joint. Without an <inertial>, its
inertia is that of its geoms, each with its own mass. As in MuJoCo, geoms that are only drawn also have a mass.
"""

from __future__ import annotations

import copy
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
    "inertial": "pos quat mass diaginertia",
    "geom": "name class type size pos quat euler fromto mesh mass density rgba material friction group condim contype "
    "conaffinity",
}
"""Known attributes and parts of each element of MJCF."""
DENSITY = 1000.0
"""Density in kg/m3 of a geom in MJCF without a mass."""


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


def arm(path: Path, speed: float) -> Element:
    """The URDF of an arm in an MJCF file, with absolute names of meshes. Elements unknown to fixtures are left out.

    Its torques are those of its actuators, or limits of its joints; MJCF has no speeds.

    Args:
        speed: of all joints, in rad/s.

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
        limits = actuator.get("forcerange") or (actuator.get("ctrlrange") if actuator.tag == "motor" else None)
        gear = (urdf.numbers(actuator.get("gear", "1")) or [1.0])[0]
        torques[actuator.get("joint", "")] = max(map(abs, urdf.numbers(limits or "0") or [0.0])) * abs(gear)
    for joint in reader.robot.iterfind("joint"):
        for limit in joint.findall("limit"):
            limit.set("velocity", repr(speed))
            if torque := torques.get(joint.get("name", "")):
                limit.set("effort", repr(torque))
    return reader.robot


class _MjcfReader:
    """Reads the links of an MJCF file."""

    def __init__(
        self, path: Path, collision: meshes.Collision | None, root: Element, lines: dict[Element, int]
    ) -> None:
        self._path, self._collision, self._root, self._lines = path, collision, root, lines
        self._files: dict[str, tuple[Path, float] | PluginError] = {}
        """Files of meshes and their scales; an error counts only if a shape needs the mesh."""
        self._degree = np.pi / 180
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
            for mesh in self._parts(part, "mesh") if part.tag == "asset" else ():
                self._complete(mesh, "main")
                file, scale = folder / mesh.get("file", ""), self._numbers(mesh, "scale", (1.0, 1.0, 1.0))
                usable = file.is_file() and file.suffix.lower() in meshes.MESH_SUFFIXES and not np.ptp(scale)
                needs = f"it needs a file of {', '.join(meshes.MESH_SUFFIXES)}, and one scale for all axes"
                found = (file, float(scale[0])) if usable else self._error(mesh, needs)
                self._files[mesh.get("name", file.stem)] = found
            bodies += self._parts(part, "body") if part.tag == "worldbody" else []
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
        self._usual[name] = own
        for part in default.findall("default"):
            self._learn(part, part.get("class", ""), own)

    def _complete(self, element: Element, usual: str) -> None:
        """Give an element the attributes of its class, or of the class `usual`."""
        name = element.get("class", usual)
        if name not in self._usual:
            raise self._error(element, f"there is no class {urdf.short(name)}")
        turned = "quat" in element.attrib or "euler" in element.attrib
        for key, value in self._usual[name].get(element.tag, {}).items():
            if not (turned and key in ("quat", "euler")):
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
            a, b, c = self._numbers(element, "euler", (0.0,) * 3) * self._degree
            x_, y_, z_ = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
            x, y, z, w = quaternion_of(urdf.about(x_, a) @ urdf.about(y_, b) @ urdf.about(z_, c))
        if not any((w, x, y, z)):
            raise self._error(element, "its quat is 0")
        return self._numbers(element, "pos", (0.0, 0.0, 0.0)), (x, y, z, w)

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

    def _base(self, bodies: Sequence[Element]) -> Element:
        if len(bodies) < 2:
            return super()._base(bodies)
        both = Element("body", name="world")  # two arms side by side; the user chooses one by its tool
        both.extend(bodies)
        return both

    def _body(self, body: Element, parent: str, offset: Array, usual: str) -> Iterator[Link]:
        parts, usual = self._parts(body, "joint inertial geom body"), body.get("childclass", usual)
        for part in parts:
            self._complete(part, usual)
        joints = [part for part in parts if part.tag == "joint"]
        if len(joints) > 1:
            raise self._error(body, f"one body has {len(joints)} joints", "a body of an arm has one joint")
        pivot = self._numbers(joints[0], "pos", (0.0, 0.0, 0.0)) if joints else np.zeros(3)
        name, (place, turn) = body.get("name", f"body{len(self.robot)}"), self._pose(body)
        drawn = [geom for geom in parts if geom.tag == "geom"]
        solid = [geom for geom in drawn if (geom.get("contype"), geom.get("conaffinity")) != ("0", "0")] or drawn
        shapes = [self._shape(geom, pivot, "convex") for geom in solid]
        mass, inertia = sum(self._number(geom, "mass", 0.0) for geom in drawn), None
        for inertial in (part for part in parts if part.tag == "inertial"):
            mass, inertia = self._inertial(inertial, pivot)
        self.robot.append(link_element(name, shapes, mass, inertia, GREY))
        if parent:
            kind = {"hinge": "revolute", "slide": "prismatic"}[joints[0].get("type", "hinge")] if joints else "fixed"
            title = joints[0].get("name", f"{name}_joint") if joints else f"{name}_fixed"
            made = SubElement(self.robot, "joint", name=title, type=kind)
            SubElement(made, "parent", link=parent)
            SubElement(made, "child", link=name)
            place_element(made, vector(place - offset + matrix_of(turn) @ pivot), turn)
            for joint in joints:
                scale = self._degree if kind == "revolute" else 1.0
                low, high = (self._numbers(joint, "range", (-2 * np.pi / scale, 2 * np.pi / scale)) * scale).tolist()
                axis = self._numbers(joint, "axis", (0.0, 0.0, 1.0))
                SubElement(made, "axis", xyz=" ".join(map(repr, axis.tolist())))
                torque = self._numbers(joint, "actuatorfrcrange", (0.0, 0.0))
                SubElement(made, "limit", lower=repr(low), upper=repr(high), effort=repr(float(np.abs(torque).max())))
                damping, friction = (self._number(joint, key, 0.0) for key in ("damping", "frictionloss"))
                SubElement(made, "dynamics", damping=repr(damping), friction=repr(friction))
        for part in parts:
            if part.tag == "body":
                yield from self._body(part, name, pivot, usual)

    def _parts(self, element: Element, known: str) -> list[Element]:
        return [part for part in element if part.tag in known.split()]


def _from_z(along: Array) -> Quaternion:
    """A rotation that turns the z axis in this direction."""
    ahead = along / np.linalg.norm(along)
    across = np.cross(ahead, np.eye(3)[np.argmin(np.abs(ahead))])
    across /= np.linalg.norm(across)
    return quaternion_of(np.column_stack([across, np.cross(ahead, across), ahead]))
