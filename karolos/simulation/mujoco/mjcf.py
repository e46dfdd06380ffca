"""Arms, fixtures and objects with joints from MJCF files, read by MuJoCo's own compiler.

Classes, frames, orientations, copies, masses and inertias are therefore those of MuJoCo. Geoms that are only drawn
(contype and conaffinity 0) do not collide, but have a mass. Materials, cameras, lights, sites, sensors, options and the
parameters of the solver are left out. Karolos refuses parts that it cannot simulate, and names their line:

* `<model>`, and geoms other than box, sphere, cylinder, capsule, and mesh;
* in a fixture or object: more than one body in `<worldbody>`, a moving body without exactly one hinge or slide with a
  range, springs, armature, `ref`, gravity compensation, actuators, tendons, equalities, pairs and excludes of contacts;
* in an arm: a ball joint, and several joints of one body.

Objects beside an arm that move freely or as a target (mocap) are left out.
A link of a fixture has the name of its joint, a link of an arm that of its body.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import mujoco
import numpy as np

from ...core import Array
from ...errors import PluginError, UsageError
from .. import meshes, urdf
from ..geometry import Quaternion, Vector, matrix_of, quaternion_of, vector
from ..parts import GREY, Link, Mechanism, link_element, mechanism, place_element
from ..shapes import Capsule, Cuboid, Cylinder, Inertia, Mesh, Shape, Sphere

JOINTS = {mujoco.mjtJoint.mjJNT_HINGE: "hinge", mujoco.mjtJoint.mjJNT_SLIDE: "slide"}
NOT_IN_FIXTURES = ("actuators", "tendons", "equalities", "pairs", "excludes", "flexes", "plugins")
"""Parts of a file that would change the motion of a fixture."""
ONE_FILE = "mujoco writes one file: s = mujoco.MjSpec.from_file(FILE); s.compile(); s.to_xml()"
FIXTURES = "docs/parts.md lists what of MJCF is known; a URDF may say more"


def fixture(path: Path, root: Element, lines: dict[Element, int], collision: meshes.Collision | None) -> Mechanism:
    """A fixture or an object with joints. Raises PluginError with the line that cannot be simulated.

    Args:
        path: of the file.
        root: its XML.
        lines: line of each element of it.
        collision: collision shapes of its meshes, see `fixtures.read`.
    """
    file = _MjcfFile(path, root, lines)
    for kind in NOT_IN_FIXTURES:
        for part in getattr(file.spec, kind):
            raise file.error(part, "a fixture has no " + kind, FIXTURES)
    base, *others = file.bodies(collision)
    if any(not body.parent for body in others):
        raise PluginError("several bodies in <worldbody>; it needs one, the base", where=str(path), hint=FIXTURES)
    if base.joints:
        raise file.error(base.element, "the base of a fixture has no joint", FIXTURES)
    links = [Link(name=base.name, shapes=base.shapes)]
    names, offsets = {base.name: base.name}, {base.name: np.zeros(3)}
    for body in others:
        if [joint.kind in JOINTS.values() and joint.limited for joint in body.joints] != [True]:
            raise file.error(body.element, "a moving body needs one joint, a hinge or slide with a range", FIXTURES)
        [joint] = body.joints
        if lost := [name for name, value in joint.unknown.items() if value]:
            raise file.error(joint.element, f"{', '.join(lost)} is not known to karolos", FIXTURES)
        names[body.name], offsets[body.name] = joint.name, joint.position
        links.append(
            Link(
                name=joint.name,
                shapes=body.shapes,
                mass=body.mass,
                inertia=body.inertia,
                parent=names[body.parent],
                joint="hinge" if joint.kind == "hinge" else "slide",
                axis=vector(joint.axis),
                range=joint.range,
                friction=joint.friction,
                damping=joint.damping,
                position=vector(body.position - offsets[body.parent] + matrix_of(body.orientation) @ joint.position),
                orientation=body.orientation,
            )
        )
    return mechanism(links)


def arm(path: Path, root: Element, lines: dict[Element, int], speed: float, slide: float) -> Element:
    """The URDF of an arm, with absolute names of meshes. Bodies without a joint are fixed to the body before.

    Its torques are those of its actuators, or limits of its joints; MJCF has no speeds. Raises PluginError with the
    line of what cannot be simulated.

    Args:
        path, root, lines: as in `fixture`.
        speed: of turning joints, in rad/s.
        slide: of sliding joints, in m/s.
    """
    file = _MjcfFile(path, root, lines)
    with warnings.catch_warnings(action="ignore"):  # no hull determines a mass
        bodies = list(file.bodies("convex", file.objects()))
    robot = Element("robot", name=root.get("model", "arm"))
    if not bodies:
        raise PluginError("no bodies in <worldbody>", where=str(path), hint="an arm is a tree of bodies")
    roots, top = [body for body in bodies if not body.parent], ""
    if len(roots) > 1 or roots[0].joints or roots[0].placed:
        top = "world"  # of two arms side by side the user chooses one by its tool
        robot.append(link_element(top, (), 0.0, None, GREY))
    offsets, torques = {top: np.zeros(3)}, file.torques()
    for body in bodies:
        if len(body.joints) > 1:
            raise file.error(body.element, f"one body has {len(body.joints)} joints", "a body of an arm has one joint")
        offsets[body.name] = body.joints[0].position if body.joints else np.zeros(3)
        robot.append(link_element(body.name, body.shapes, body.mass, body.inertia, GREY))
        if not (parent := body.parent or top):
            continue
        title = body.joints[0].name if body.joints else f"{body.name}_fixed"
        made = SubElement(robot, "joint", name=title, type="fixed")
        SubElement(made, "parent", link=parent)
        SubElement(made, "child", link=body.name)
        turn = body.orientation
        origin = body.position - offsets[parent] + matrix_of(turn) @ offsets[body.name]
        for joint in body.joints:
            if joint.kind not in JOINTS.values():
                raise file.error(joint.element, f"a {joint.kind} joint", "joints of an arm are hinges and slides")
            turns = joint.kind == "hinge"
            made.set("type", "revolute" if turns else "prismatic")
            SubElement(made, "axis", xyz=" ".join(map(repr, joint.axis.tolist())))
            low, high = joint.range if joint.limited else (-2 * np.pi, 2 * np.pi)
            limit = {"lower": low, "upper": high, "effort": torques[joint.number]}
            limit["velocity"] = speed if turns else slide
            SubElement(made, "limit", {key: repr(float(value)) for key, value in limit.items()})
            SubElement(made, "dynamics", damping=repr(joint.damping), friction=repr(joint.friction))
            if turns:  # the file has the joint at `ref`, a URDF at 0
                turn = quaternion_of(matrix_of(turn) @ urdf.about(vector(joint.axis), -joint.unknown["ref"]))
            else:
                origin = origin - matrix_of(turn) @ joint.axis * joint.unknown["ref"]
        place_element(made, vector(origin), turn)
    return robot


@dataclass(frozen=True)
class _MjcfJoint:
    """A joint of the compiled model, in the frame of its body. Units: m, rad, N, N m."""

    number: int
    element: Any
    name: str
    kind: str
    position: Array
    axis: Array
    limited: bool
    range: tuple[float, float]
    friction: float
    damping: float
    unknown: dict[str, float]
    """What a fixture cannot have."""


@dataclass(frozen=True)
class _MjcfBody:
    """A body of the compiled model, and its pose in its parent. Shapes and inertia are in the frame at its joint."""

    element: Any
    name: str
    parent: str
    position: Array
    orientation: Quaternion
    joints: Sequence[_MjcfJoint]
    shapes: Sequence[Shape]
    mass: float
    inertia: Inertia | None

    @property
    def placed(self) -> bool:
        """Whether its frame is not that of its parent."""
        return bool(self.position.any()) or not np.allclose(matrix_of(self.orientation), np.eye(3))


class _MjcfFile:
    """An MJCF file and its compiled model."""

    def __init__(self, path: Path, root: Element, lines: dict[Element, int]) -> None:
        self._path = path
        for part in root.iter("model"):  # its meshes have places of their own
            raise PluginError("<model> is not known to karolos", where=f"{path}:{lines[part]}", hint=ONE_FILE)
        self._has_lines = next(root.iter("include"), None) is None
        """Whether the lines that MuJoCo names are those of this file."""
        self.spec = self._tried(lambda: mujoco.MjSpec.from_file(str(path)))
        self._meshes: dict[str, tuple[Path, Vector]] = {}
        """File and scale of the meshes that shapes use."""
        self._keep_what_is_used()
        self._model = self._tried(self.spec.compile)

    def objects(self) -> set[int]:
        """The bodies that move freely or as a target of control (mocap), and carry no further joint."""
        model = self._model
        roots = model.body_rootid
        free = {int(roots[body]) for body in model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]}
        free |= {int(roots[body]) for body in np.flatnonzero(model.body_mocapid >= 0)}
        free -= {int(roots[body]) for body in model.jnt_bodyid[model.jnt_type != mujoco.mjtJoint.mjJNT_FREE]}
        return {number for number in range(1, model.nbody) if int(roots[number]) in free}

    def bodies(self, collision: meshes.Collision | None, without: Collection[int] = ()) -> Iterator[_MjcfBody]:
        """The bodies except those in `without`, each after its parent. A body that moves freely has no joint."""
        model = self._model
        elements = {element.id: element for element in self.spec.bodies}
        for number in range(1, model.nbody):
            if number in without:
                continue
            first = model.body_jntadr[number]
            joints = [self._joint(one) for one in range(first, first + model.body_jntnum[number])]
            joints = [joint for joint in joints if joint.kind != "free"]
            pivot = joints[0].position if joints else np.zeros(3)
            mass, centre = float(model.body_mass[number]), model.body_ipos[number] - pivot
            moments, axes = vector(model.body_inertia[number]), _quaternion(model.body_iquat[number])
            first = model.body_geomadr[number]
            geoms = range(first, first + model.body_geomnum[number])
            solid = [one for one in geoms if model.geom_contype[one] or model.geom_conaffinity[one]]
            yield _MjcfBody(
                element=elements[number],
                name=self._name(number),
                parent=self._name(model.body_parentid[number]),
                position=model.body_pos[number].copy(),
                orientation=_quaternion(model.body_quat[number]),
                joints=joints,
                shapes=[
                    self._shape(one, pivot, collision)
                    for one in solid or [geom for geom in geoms if not self._flat(geom)]
                ],
                mass=mass,
                inertia=Inertia(vector(centre), moments, axes) if mass else None,
            )

    def torques(self) -> Array:
        """Largest torque or force of each joint (n,) in N m or N: of its actuator, or else its own limit."""
        model = self._model
        found = np.where(model.jnt_actfrclimited, np.abs(model.jnt_actfrcrange).max(axis=1), 0.0)
        joints = {int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)}
        for number in range(model.nu):
            constant = model.actuator_gaintype[number] == mujoco.mjtGain.mjGAIN_FIXED
            constant &= model.actuator_biastype[number] == mujoco.mjtBias.mjBIAS_NONE
            most = 0.0
            if model.actuator_forcelimited[number]:
                most = np.abs(model.actuator_forcerange[number]).max()
            elif model.actuator_ctrllimited[number] and constant:
                most = np.abs(model.actuator_ctrlrange[number]).max() * abs(model.actuator_gainprm[number, 0])
            if most and int(model.actuator_trntype[number]) in joints:
                found[model.actuator_trnid[number, 0]] = most * abs(model.actuator_gear[number, 0])
        return found

    def error(self, element: Any, what: str, hint: str | None = None) -> PluginError:
        """The error of an element of the file."""
        line = "".join(f":{number}" for number in re.findall(r"line (\d+)", element.info)[: self._has_lines])
        kind = type(element).__name__.removeprefix("Mjs").lower()
        return PluginError(what, where=f"{self._path}{line}: {kind} {element.name}".strip(), hint=hint)

    def _tried(self, step: Callable[[], Any]) -> Any:
        """What a step of MuJoCo's compiler returns. Raises PluginError with its message."""
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda _: None)  # without it MuJoCo writes a log into the current folder
        try:
            with warnings.catch_warnings(action="ignore"):  # of its own physics
                return step()
        except ValueError as error:
            form = r"(?:XML )?(?:Error: )*(.*?),?(?: Element (?:name )?'(.*?)'.*?)?(?: line (\d+).*)?"
            found = re.fullmatch(form, " ".join(str(error).split()))
            what, name, line = found.groups() if found else (str(error), None, None)
            where = f"{self._path}:{line}" if line and self._has_lines else str(self._path)
            raise PluginError(f"MuJoCo refuses it: {what}", where=f"{where}: {name}" if name else where) from None
        finally:
            mujoco.set_mju_user_warning(before)

    def _keep_what_is_used(self) -> None:
        """Leave out what is only drawn and may lack files: textures, and meshes that karolos cannot read."""
        spec, folder = self.spec, self._path.parent / self.spec.meshdir
        for part in [*spec.geoms, *spec.sites, *spec.tendons]:
            part.material = ""
        for part in [*spec.materials, *spec.textures, *spec.skins]:
            spec.delete(part)
        spec.compiler.fusestatic = spec.compiler.discardvisual = False
        problems: dict[str, str] = {}
        for mesh in spec.meshes:
            file = folder / (Path(mesh.file).name if spec.strippath else mesh.file)
            if problem := _unusable(mesh, file):
                problems[mesh.name] = problem
            else:
                self._meshes[mesh.name] = file, vector(mesh.scale)
        for body in spec.bodies:
            geoms = list(body.geoms)
            solid = [geom for geom in geoms if geom.contype or geom.conaffinity] or geoms
            for geom in geoms:
                if geom.type != mujoco.mjtGeom.mjGEOM_MESH or geom.meshname not in problems:
                    continue
                if geom in solid:
                    raise self.error(spec.mesh(geom.meshname), problems[geom.meshname])
                spec.delete(geom)
        used = {geom.meshname for geom in spec.geoms}
        for mesh in list(spec.meshes):
            if mesh.name not in used:
                spec.delete(mesh)

    def _name(self, number: int) -> str:
        """The name of a body; "" for the world."""
        return self._model.body(number).name or f"body{number}" if number else ""

    def _joint(self, number: int) -> _MjcfJoint:
        model = self._model
        dof, place = model.jnt_dofadr[number], model.jnt_qposadr[number]
        low, high = model.jnt_range[number].tolist()
        [element] = [one for one in self.spec.joints if one.id == number]
        kind = mujoco.mjtJoint(model.jnt_type[number])
        return _MjcfJoint(
            number=number,
            element=element,
            name=element.name or f"{self._name(model.jnt_bodyid[number])}_joint",
            kind=JOINTS.get(kind, kind.name.removeprefix("mjJNT_").lower()),
            position=model.jnt_pos[number].copy(),
            axis=model.jnt_axis[number].copy(),
            limited=bool(model.jnt_limited[number]),
            range=(low, high),
            friction=float(model.dof_frictionloss[dof]),
            damping=float(model.dof_damping[dof]),
            unknown={
                "ref": float(model.qpos0[place]),
                "stiffness": float(model.jnt_stiffness[number]),
                "armature": float(model.dof_armature[dof]),
                "gravcomp": float(model.body_gravcomp[model.jnt_bodyid[number]]),
            },
        )

    def _flat(self, number: int) -> bool:
        """Whether a geom is a mesh without a convex hull."""
        name = self._model.mesh(self._model.geom_dataid[number]).name if self._model.geom_dataid[number] >= 0 else ""
        return name in self._meshes and meshes.is_flat(self._meshes[name][0])

    def _shape(self, number: int, pivot: Array, collision: meshes.Collision | None) -> Shape:
        """The shape of a geom in the frame at `pivot` (3,) of its body."""
        model = self._model
        place, turn = model.geom_pos[number], matrix_of(_quaternion(model.geom_quat[number]))
        kind = mujoco.mjtGeom(model.geom_type[number])
        if kind == mujoco.mjtGeom.mjGEOM_MESH:  # MuJoCo moves its frame to the centre of mass
            mesh = model.geom_dataid[number]
            turn = turn @ matrix_of(_quaternion(model.mesh_quat[mesh])).T
            place = place - turn @ model.mesh_pos[mesh]
        pose: dict[str, Any] = {"position": vector(place - pivot), "orientation": quaternion_of(turn)}
        a, b, c = (2 * model.geom_size[number]).tolist()
        [element] = [one for one in self.spec.geoms if one.id == number]
        try:
            match kind:
                case mujoco.mjtGeom.mjGEOM_MESH:
                    return Mesh(*self._meshes[model.mesh(mesh).name], collision, **pose)
                case mujoco.mjtGeom.mjGEOM_BOX:
                    return Cuboid((a, b, c), **pose)
                case mujoco.mjtGeom.mjGEOM_SPHERE:
                    return Sphere(a / 2, **pose)
                case mujoco.mjtGeom.mjGEOM_CYLINDER:
                    return Cylinder(a / 2, b, **pose)
                case mujoco.mjtGeom.mjGEOM_CAPSULE:
                    return Capsule(a / 2, b, **pose)
        except UsageError as error:
            raise self.error(element, str(error)) from None
        name = kind.name.removeprefix("mjGEOM_").lower()
        raise self.error(element, f"its type is {name}; known are box, sphere, cylinder, capsule and mesh")


def _unusable(mesh: Any, file: Path) -> str:
    """Why karolos cannot use a mesh; empty if it can."""
    if not mesh.file or file.suffix.lower() not in meshes.MESH_SUFFIXES:
        return f"it is no file of {', '.join(meshes.MESH_SUFFIXES)}; convert it"
    if not file.is_file():
        return f"there is no file {file}"
    if np.any(mesh.refpos) or abs(mesh.refquat[0]) != 1:
        return "it has refpos or refquat; apply them to its file, and leave them out"
    try:
        meshes.check_size(file, mesh.scale.tolist())
    except PluginError as error:  # which does not know the line
        return str(error)
    return ""


def _quaternion(numbers: Array) -> Quaternion:
    """x y z w from MuJoCo's w x y z."""
    w, x, y, z = numbers.tolist()
    return x, y, z, w
