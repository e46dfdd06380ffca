"""Finds everything that prevents the use of a URDF as an arm, and repairs what arithmetic can repair in a copy."""

from __future__ import annotations

import os
import re
from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from math import pi
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement
from xml.parsers.expat import ExpatError

import numpy as np

from ..core import Array
from ..errors import KarolosError, PluginError
from ..simulation import urdf
from ..simulation.fixtures import arm
from ..simulation.meshes import MESH_SUFFIXES, Solid, check_size, hull, triangles
from ..system.files import MOST_FILES, find_named, write_whole
from .proposal import points_of

DENSITY = 1500.0
"""Density in kg/m3 for the convex hulls of links without a mass, as for a UR5's links."""
HELD = 3.0
"""Largest torque of a motor without a stated torque, relative to the torque that holds the stretched arm."""
USUAL_SPEED, USUAL_SLIDE, USUAL_FORCE = 2.0, 0.1, 20.0
"""Speed in rad/s and m/s of a joint without a stated speed, and force in N of a slide."""
GRAVITY = 9.81
PAYLOAD, PAYLOAD_SHARE, PAYLOAD_ARM = 2.0, 1 / 15, 0.2
"""Smallest payload of such an arm: kg, share of its own mass (data sheets: from 1/24, a Puma, to 1/2, an iiwa), and
distance from its last joint in m."""
MJCF = (".xml", ".mjcf")
XACRO = "xmlns:xacro"
"""Declaration of its prefix."""
_PREFIX = re.compile(r"</?(\w+):|\s(\w+):\w+\s*=")
_MACRO = re.compile(r"<xacro:|\$[({]")
_DECLARED = re.compile(r"\bxmlns:(\w+)\s*=")


@dataclass(frozen=True)
class Finding:
    """A defect that prevents the use of a file as an arm."""

    where: str
    """File, line and element."""
    what: str
    change: str = ""
    """Value in the repaired copy; empty if it cannot be known."""

    @classmethod
    def of(cls, error: KarolosError, path: Path) -> Finding:
        """The defect that an error about the file at `path` says."""
        what = f"{error.what}; {error.hint}" if error.hint else error.what
        return cls(error.where or str(path), what)


class Repair:
    """A file that was read as far as possible.

    Attributes:
        findings: its defects, in the order of the repair.
        robot: the repaired copy; None if the file is not a URDF at all. Its meshes have absolute names.

    Args:
        path: of the URDF, or of an MJCF file, which is converted to a URDF.
        mass: of the whole arm in kg, as the data sheet says; None: unknown.
        limits: whether to repair the limits of the joints, too.
        expand: whether to expand macros of xacro. Python evaluates their expressions, so use it only for trusted files.
    """

    def __init__(self, path: Path, mass: float | None = None, *, limits: bool = True, expand: bool = False) -> None:
        self.path, self.findings = path, list[Finding]()
        self.robot: Element | None = None
        try:
            if path.suffix.lower() in MJCF:
                text = ElementTree.tostring(arm(path.absolute(), USUAL_SPEED, USUAL_SLIDE), "unicode")
                change = f"{USUAL_SPEED:g} rad/s, slides {USUAL_SLIDE:g} m/s; write the data sheet's into a URDF"
                self.findings.append(Finding(str(path), "MJCF has no speeds of joints", change))
            else:
                text = urdf.text_of(path)
                if expand and XACRO in text and _MACRO.search(text):
                    text = _expanded(path)
                    change = "expanded with the values that the file gives"
                    self.findings.append(Finding(str(path), "macros of xacro", change))
                text = self._declared(text)
            carriers = urdf.load(path, strict=False, text=text).carriers  # an error at the line if it is not a URDF
            self.robot, self._lines = urdf.parse(path, text)
            self._drawn = urdf.drawn_links(self.robot, carriers)
            self._repair(self.robot, mass, limits=limits)
        except PluginError as error:
            self.findings.append(Finding.of(error, path))

    def write(self, path: Path) -> None:
        """Write the repaired copy, with names of meshes relative to its folder. Raises PluginError, MachineError."""
        if self.robot is None:
            raise PluginError("it is not a URDF and cannot be repaired", where=str(self.path))
        for mesh in self.robot.iter("mesh"):
            mesh.set("filename", os.path.relpath(mesh.get("filename", ""), path.absolute().parent).replace(os.sep, "/"))
        write_whole(path, self._text() + "\n")

    def _text(self) -> str:
        assert self.robot is not None
        ElementTree.indent(self.robot)
        return ElementTree.tostring(self.robot, "unicode")

    def _found(self, element: Element, what: str, change: str = "") -> None:
        line = "" if self.path.suffix.lower() in MJCF else f":{self._lines.get(element, 0)}"
        place = f"{self.path}{line}: {element.tag} {element.get('name')}"
        self.findings.append(Finding(place, what, change))

    def _declared(self, text: str) -> str:
        """The text with all prefixes declared."""
        used = {one for pair in _PREFIX.findall(re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)) for one in pair}
        missing = sorted(used - {*_DECLARED.findall(text), "xmlns", "xml", ""})
        if missing:
            what = f"the prefix {', '.join(missing)} is not declared"
            self.findings.append(Finding(str(self.path), what, "what has it is left out"))
        names = "".join(f' xmlns:{one}="undeclared"' for one in missing)
        return re.sub(r"<robot\b", f"<robot{names}", text, count=1)

    def _repair(self, robot: Element, mass: float | None, *, limits: bool) -> None:
        for parent in [*robot.iter()]:
            for key in [key for key in parent.attrib if "}" in key]:
                del parent.attrib[key]
            for part in [part for part in parent if "}" in part.tag]:
                parent.remove(part)
        for link in robot.findall("link"):
            self._find_meshes(link)
        loose = urdf.load(self.path, strict=False, text=self._text())
        self._weigh(robot, loose, mass)
        elements = {one.get("name"): one for one in robot.findall("joint")}
        slides = {joint.name for joint in loose.joints if not joint.revolute}
        for joint in loose.joints if limits else ():
            if joint.name not in slides or joint.mimic not in slides:  # otherwise it has the limits of the other finger
                self._limit(elements[joint.name], joint, loose)

    def _find_meshes(self, link: Element) -> None:
        """Give the meshes of a link absolute names, and leave out those that are missing or cannot be read."""
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            for mesh in shape.iter("mesh"):
                name, kind = mesh.get("filename", ""), shape.tag
                found, change = find_named(name, self.path.parent), ""
                if found is None and (found := self._nearby(name)) is not None:
                    change = f"{found}, which has its name"
                    self._found(link, f"there is no mesh {urdf.short(name)}", change)
                problem = "" if found is not None else f"there is no mesh {urdf.short(name)}"
                if found is not None:
                    mesh.set("filename", str(found))
                    problem = self._unreadable(found, mesh)
                if problem:
                    drawn = kind == "visual" and link.get("name") in self._drawn
                    self._found(link, problem, "it is not drawn" if drawn else "")
                    link.remove(shape)

    def _unreadable(self, path: Path, mesh: Element) -> str:
        """Why a mesh cannot be used; empty if it can."""
        if path.suffix.lower() not in MESH_SUFFIXES:
            return f"cannot read the mesh {path.name}: meshes end in {', '.join(MESH_SUFFIXES)}"
        try:
            triangles(path)
            check_size(path, [float(one) for one in mesh.get("scale", "1 1 1").split()])
        except PluginError as error:
            return str(error)
        return ""

    def _nearby(self, name: str) -> Path | None:
        """The only file of this name in the folders around the URDF; None if there is none or more than one."""
        base = name.replace("\\", "/").rpartition("/")[2].lower()
        return next((files[base][0].resolve() for files in self._around if len(files[base]) == 1), None)

    @cached_property
    def _around(self) -> list[dict[str, list[Path]]]:
        """The files, by name in lower case, of the URDF's folder and of the two above it."""
        found: list[dict[str, list[Path]]] = []
        for folder in self.path.absolute().parents[:3]:
            files, count = defaultdict[str, list[Path]](list), 0
            for place, folders, names in os.walk(folder):
                if (count := count + len(folders) + len(names)) > MOST_FILES:
                    return found  # a home or a disk, with the meshes of other robots
                for one in names:
                    files[one.lower()].append(Path(place, one))
            found.append(files)
        return found

    def _weigh(self, robot: Element, loose: urdf.Description, mass: float | None) -> None:
        """Give moving links their missing masses and inertias, and the arm its whole mass."""
        links = {one.get("name", ""): one for one in robot.findall("link")}
        carried = [joint.child for joint in loose.joints]
        known = {one.get("name", ""): urdf.inertia_of(one) for one in loose.robot.findall("link")}
        solids = {name: hull(points_of(loose.robot, name)) for name in known}
        without = [name for name in carried if known[name][0] < urdf.LEAST_SIZE]
        there = sum(weight for weight, _, _ in known.values())
        volume, density = sum(solids[name].volume for name in without), DENSITY
        if without and mass is not None:
            if not there:  # not even the base's
                volume += sum(solids[name].volume for name in known if name not in carried)
            density = max(mass - there, 0.1 * mass) / volume
        for name in without:
            weight = density * solids[name].volume
            change = f"{weight:.3g} kg: its convex hull of {density:.0f} kg/m3"
            self._found(links[name], "it moves and has no mass", change)
            _set_inertia(links[name], weight, solids[name])
        for name in carried:
            weight, _, tensor = known[name]
            if name not in without and np.linalg.eigvalsh(tensor)[0] < urdf.LEAST_INERTIA:
                self._found(links[name], "its inertia is not positive definite", "that of its convex hull")
                _set_inertia(links[name], weight, solids[name])
                for other in (other for other, carrier in loose.carriers.items() if carrier == name != other):
                    for old in links[other].findall("inertial"):  # the hull has the mass of all that is fixed to it
                        links[other].remove(old)
        if mass is not None and there and not without and abs(there / mass - 1) > 0.01:
            what = f"its links weigh {there:.4g} kg together, the data sheet says {mass:g}"
            self.findings.append(
                Finding(str(self.path), what, f"masses and inertias are multiplied by {mass / there:.3g}")
            )
            for one in (one for part in ("mass", "inertia") for one in robot.iterfind(f"link/inertial/{part}")):
                numbers = {key: urdf.numbers(value) for key, value in one.attrib.items()}
                one.attrib.update({key: repr(value[0] * mass / there) for key, value in numbers.items() if value})

    def _limit(self, element: Element, joint: urdf.Joint, loose: urdf.Description) -> None:
        """Give a joint its missing limits."""
        limit = element.find("limit")
        if limit is None:
            limit = SubElement(element, "limit")
        lacking = dict[str, tuple[str, float]]()
        if joint.effort <= 0:
            held = self._held(joint, loose) if joint.revolute else USUAL_FORCE / HELD
            how = f"{HELD:g} times what holds the stretched arm" if joint.revolute else "assumed"
            lacking["effort"] = how, HELD * held + joint.friction
        if joint.velocity <= 0:
            lacking["velocity"] = "assumed; write the data sheet's", USUAL_SPEED if joint.revolute else USUAL_SLIDE
        if not joint.lower < joint.upper and element.get("type") != "continuous":
            lacking |= {"lower": ("assumed", -pi), "upper": ("assumed", pi)} if joint.revolute else {}
        for key, (how, value) in lacking.items():
            dry = f", of which friction takes {joint.friction:g}" if key == "effort" and joint.friction else ""
            self._found(element, f"its {key} is {limit.get(key, 'missing')}{dry}", f"{value:.3g}: {how}")
            limit.set(key, f"{value:.6g}")

    def _held(self, joint: urdf.Joint, loose: urdf.Description) -> float:
        """The torque in N m that holds the load of a joint, stretched out horizontally with a payload."""
        assert self.robot is not None
        masses, total, furthest = (
            {one.get("name"): urdf.inertia_of(one) for one in self.robot.findall("link")},
            0.0,
            0.0,
        )
        reached = [(joint.child, 0.0)]
        for link, away in reached:  # which grows
            for name in (name for name, carrier in loose.carriers.items() if carrier == link):
                mass, centre, _ = masses[name]
                total += mass * (away + float(np.linalg.norm(loose.frames[name][0] + loose.frames[name][1] @ centre)))
            furthest = max(furthest, away)
            below = (one for one in loose.joints if one.parent == link)
            reached += [(one.child, away + float(np.linalg.norm(one.origin))) for one in below]
        payload = max(PAYLOAD, PAYLOAD_SHARE * sum(mass for mass, _, _ in masses.values()))
        return GRAVITY * (total + payload * (furthest + PAYLOAD_ARM))


def _expanded(path: Path) -> str:
    """The text of a URDF without macros of xacro. Raises PluginError if files or packages for them are missing.

    `$(find PACKAGE)` is the folder of this name in those above the file, as in a checkout, or else the file's own
    package.
    """
    try:
        xacro: Any = import_module("xacro")
        arguments: Any = import_module("xacro.substitution_args")
    except ImportError:
        hint = "pip install xacro"
        raise PluginError("macros of xacro, which are not expanded", where=str(path), hint=hint) from None

    def find(package: str) -> str:
        above = path.absolute().parents
        places = (place for one in above for place in (one, one / package))
        named = (place for place in places if place.name == package and place.is_dir())
        return str(next(named, above[1]))  # the file's own package may have been renamed

    arguments._eval_find = find
    try:
        text: str = xacro.process_file(str(path)).toxml()
    except (xacro.XacroException, arguments.SubstitutionException, ExpatError, OSError) as error:
        what = " ".join(str(error).splitlines())
        raise PluginError(f"xacro cannot expand it: {what}", where=str(path)) from None
    except RecursionError:
        hint = "xacro:include or a macro without an end"
        raise PluginError("xacro cannot expand it: it uses itself", where=str(path), hint=hint) from None
    return text


def _set_inertia(link: Element, mass: float, solid: Solid) -> None:
    """Give a link a mass, and the inertia of this solid."""
    for old in link.findall("inertial"):
        link.remove(old)
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=" ".join(f"{one:.6g}" for one in solid.centre), rpy="0 0 0")
    SubElement(inertial, "mass", value=f"{mass:.6g}")
    tensor: Array = solid.tensor * mass
    names = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}
    SubElement(inertial, "inertia", {key: f"{tensor[place]:.6g}" for key, place in names.items()})
