"""A MuJoCo world, and its OpenGL renderer without a visible window."""

from __future__ import annotations

import copy
import os
from collections.abc import Iterator, Sequence
from importlib import import_module
from itertools import combinations, product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from ...core import Array, FloatArray
from ...errors import MachineError, PluginError
from ...system import RENDERER_HINT, RENDERERS
from .. import parts
from ..engines import MUJOCO
from ..fixtures import read
from ..geometry import Colour, Vector
from ..interface import (
    FLOOR_FRICTION,
    OBJECT_MATERIAL,
    PHYSICS_RATE,
    Body,
    Camera,
    Contact,
    Cup,
    Fingers,
    Frame,
    JointLimits,
    Stroke,
)
from ..meshes import stl, triangles
from ..parts import Mechanism
from ..picture import Eye, Marker, draw
from ..shapes import Inertia, Shape
from ..urdf import link_of
from .motors import MujocoMotors, Passive
from .simulation import JOINT_IMPEDANCE, MujocoBody, Simulation

MARGIN = 0.005
"""Distance in m between two bodies below which contacts are searched. A body that moves further in a physics step is
noticed only inside the other one."""


class MujocoWorld:
    """Implements `interface.World`.

    Contacts have the product of the friction coefficients of both bodies, as in PyBullet. Therefore every pair of
    shapes that may touch is declared; MuJoCo alone would use the larger coefficient.

    Args:
        rate: physics steps per second.

    Raises UsageError if a window is requested, because there is none.
    """

    def __init__(
        self,
        *,
        substeps: int = 10,
        rate: int = PHYSICS_RATE,
        window: bool = False,
        camera: Camera | None = None,  # noqa: ARG002 (of a window)
    ) -> None:
        if window:
            raise MUJOCO.lacks("window")
        self.substeps = substeps
        self.period, self.lead = substeps / rate, 0.0
        self._simulation = simulation = Simulation(substeps, 1 / rate, self._declare_pairs, self._write_surfaces)
        self._spec, self.api = simulation.spec, simulation.api
        self._bodies: list[MujocoBody] = []
        self._motors: list[MujocoMotors | Passive] = []
        self._markers: list[tuple[MujocoBody, float, Colour]] = []
        self._renderers: dict[tuple[int, int], Renderer] = {}
        self._shown: Any = None
        """MuJoCo's data for pictures, so that these do not change the simulation."""
        self._pictured: Any = None
        """Positions of joints and bodies in the last picture of a present state: (nq,)."""
        self._spec.visual.headlight.active = 0
        self._spec.worldbody.add_light(
            type=self.api.mjtLightType.mjLIGHT_DIRECTIONAL,
            dir=(-1.5, 1.4, -3.0),
            ambient=[0.52] * 3,
            diffuse=[0.4] * 3,
            specular=[0.05] * 3,
            castshadow=False,
        )
        floor = self._spec.worldbody.add_body(name="0/floor", mocap=True)
        floor.add_geom(name="0/floor", type=self.api.mjtGeom.mjGEOM_PLANE, size=(5.0, 5.0, 0.05), group=2)
        self.floor = self._add(["0/floor"], [["0/floor"]], free=False)
        self.set_floor_friction(FLOOR_FRICTION)

    def step(self) -> None:
        self._simulation.advance(self._motors)

    def set_gravity(self, gravity: float) -> None:
        self._spec.option.gravity = (0.0, 0.0, gravity)
        if self._simulation.model is not None:
            self._simulation.model.opt.gravity[2] = gravity

    def set_floor_friction(self, friction: float) -> None:
        self.floor.set_friction(friction)

    def load(self, source: Path | Mechanism, *, position: Vector = (0.0, 0.0, 0.0)) -> MujocoBody:
        mechanism = read(source) if isinstance(source, Path) else source
        body = self._load(mechanism.robot, position=position)
        if mechanism.frictions:
            links = body.links()
            moved = {joint.get("name", ""): links[link_of(joint, "child")] for joint in mechanism.robot.iter("joint")}
            body.passive = Passive(
                self._simulation, body, {moved[name]: one for name, one in mechanism.frictions.items()}
            )
            body.passive_joints = {name: moved[name] for name in mechanism.frictions}
            self._motors.append(body.passive)
            self._simulation.parts.append(body.passive)
            for link in moved.values():
                body.set_material(OBJECT_MATERIAL, link)
        return body

    def _load(
        self, robot: Element, *, position: Vector = (0.0, 0.0, 0.0), free: bool = False, colour: Colour | None = None
    ) -> MujocoBody:
        robot, meshes = _readable(robot)
        try:
            loaded = self.api.MjSpec.from_string(ElementTree.tostring(robot, encoding="unicode"), assets=meshes)
        except ValueError as error:
            what = f"mujoco cannot load this URDF: {' '.join(str(error).split())}"
            raise PluginError(what, where=f"robot {robot.get('name', '?')}") from error
        for mesh in loaded.meshes:  # masses come from the URDF; an open mesh has no volume
            mesh.inertia = self.api.mjtMeshInertia.mjMESH_INERTIA_SHELL
        bodies = loaded.bodies[1:]
        for body in bodies:  # MuJoCo would sort the moments of a tensor, and turn its axes
            moments, products = np.split(body.fullinertia, 2)
            if moments.all() and not products.any():
                body.inertia, body.fullinertia = moments, [np.nan] * 6
        bodies[0].pos = position
        if free:
            bodies[0].add_freejoint()
        else:
            bodies[0].mocap = True
        prefix = f"{len(self._bodies)}/"
        names, shapes = [], []
        for body in bodies:
            names.append(prefix + body.name)
            shapes.append(list(self._shapes(body, prefix)))
            for geom in body.geoms if colour is not None else ():
                geom.rgba = colour
        self._spec.attach(loaded, prefix=prefix, frame=self._spec.worldbody.add_frame())
        return self._add(names, shapes, free=free)

    def _shapes(self, body: Any, prefix: str) -> Iterator[str]:
        """Name the collision geoms of a URDF's link. They are shown only if the link has no other geoms."""
        geoms = body.geoms
        visible = any(not geom.contype for geom in geoms)
        for place, geom in enumerate(geoms):
            if geom.contype:
                geom.name = f"{body.name} {place}"
                geom.group = 3 if visible else 1
                geom.contype = geom.conaffinity = 0
                yield prefix + geom.name

    def motors(
        self,
        body: Body,
        joints: Sequence[str],
        limits: JointLimits,
        fingers: Fingers | None,
        tool: Frame | None = None,
        cup: Cup | None = None,
    ) -> MujocoMotors:
        links = body.links()
        pads = [links[name] for name in fingers.links] if fingers else []
        arm = [links[name] for name in joints]
        own = self._bodies[body.index]
        motors = MujocoMotors(self._simulation, own, limits, arm, fingers, pads, tool=tool, cup=cup)
        self._motors.append(motors)
        self._simulation.parts.append(motors)
        if fingers is not None:
            first, second = (f"{body.index}/{name}" for name in fingers.joints)
            self._spec.add_equality(
                type=self.api.mjtEq.mjEQ_JOINT,
                objtype=self.api.mjtObj.mjOBJ_JOINT,
                name1=first,
                name2=second,
                data=[0.0, 1.0] + [0.0] * 10,
                solref=self._simulation.stiff,
                solimp=JOINT_IMPEDANCE,
            )
        self._simulation.restructure()
        return motors

    def release_in_motion(self) -> None:
        """Nothing to do: contacts have no memory here."""

    def body(self, shapes: Sequence[Shape], mass: float, colour: Colour, inertia: Inertia | None = None) -> MujocoBody:
        return self._load(parts.body(shapes, mass, inertia), free=mass > 0, colour=colour)

    def marker(self, radius: float, colour: Colour) -> MujocoBody:
        name = f"{len(self._bodies)}/marker"
        self._spec.worldbody.add_body(name=name, mocap=True)
        marker = self._add([name], [[]], free=False)
        self._markers.append((marker, radius, colour))
        return marker

    def forget_contacts(self) -> None:
        self._simulation.writable()

    def contacts(self, first: Body, second: Body, link: int) -> list[Contact]:
        data = self._simulation.ready()
        if not (self._simulation.stepped and data.ncon):
            return []
        bodies = self._simulation.model.geom_bodyid[data.contact.geom].tolist()
        own, others = self._bodies[first.index].ids[link + 1], self._bodies[second.index].ids
        found = []
        for place, (one, other) in enumerate(bodies):
            if one == own and other in others:
                sign = -1.0
            elif other == own and one in others:
                sign = 1.0
            else:
                continue
            row, distance = int(data.contact.efc_address[place]), float(data.contact.dist[place])
            force = float(data.efc_force[row]) if row >= 0 else 0.0
            if force > 0 or distance <= 0:
                normal = tuple((sign * data.contact.frame[place, :3]).tolist())
                found.append(Contact(normal, force, distance))
        return found

    def forces(self, body: Body) -> dict[tuple[int, int], float]:
        return self._pressing(body, self._simulation.peaks) if self._simulation.stepped else {}

    def largest_forces(self, body: Body) -> dict[tuple[int, int], float]:
        return self._pressing(body, self._simulation.largest)

    def _pressing(self, body: Body, between: FloatArray) -> dict[tuple[int, int], float]:
        """The forces on a body, given the forces between each two of MuJoCo's bodies (nbody, nbody)."""
        own, found, links = body.index, dict[tuple[int, int], float](), self._simulation.links
        firsts, seconds = between.nonzero()
        for first, second in zip(firsts.tolist(), seconds.tolist(), strict=True):
            one, other, force = links[first], links[second], between.item(first, second)
            for (index, link), (opposite, _) in ((one, other), (other, one)):
                if index == own:
                    found[link, opposite] = found.get((link, opposite), 0.0) + force
        return found

    def render(
        self, width: int, height: int, camera: Camera, strokes: Sequence[Stroke] = (), back: float = 0.0
    ) -> Array:
        data, model, api = self._simulation.ready(), self._simulation.model, self.api
        if self._shown is None:
            self._shown, self._pictured = api.MjData(model), data.qpos.copy()
        shown = self._shown
        shown.qpos[:], shown.mocap_pos[:], shown.mocap_quat[:] = data.qpos, data.mocap_pos, data.mocap_quat
        if back:
            way = np.zeros(model.nv)
            api.mj_differentiatePos(model, way, 1.0, data.qpos, self._pictured)
            api.mj_integratePos(model, shown.qpos, way, back)
        else:
            self._pictured = data.qpos.copy()
        for compute in (api.mj_kinematics, api.mj_comPos, api.mj_camlight):
            compute(model, shown)
        markers = [Marker(body.pose()[0], radius, colour) for body, radius, colour in self._markers]
        return draw(self._render_bodies, width, height, camera, markers, strokes)

    def _render_bodies(self, eye: Eye, width: int, height: int) -> tuple[NDArray[np.uint8], FloatArray]:
        size = width, height
        if size not in self._renderers:
            self._renderers[size] = Renderer(self.api, self._simulation.model, width, height)
        return self._renderers[size](self._shown, eye)

    def close(self) -> None:
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers, self._shown = {}, None

    def _write_surfaces(self, model: Any) -> None:
        """Write friction and material of every shape. MuJoCo has put the pairs into an order of its own."""
        own = np.zeros(model.ngeom)
        for body in self._bodies:
            for geoms, friction, material in zip(body.geoms, body.frictions, body.materials, strict=True):
                own[geoms] = friction
                surface = 1 / material.stiffness, material.damping, material.restitution
                self._simulation.material[geoms] = surface
        lateral = own[model.pair_geom1] * own[model.pair_geom2]
        model.pair_friction[:, :2] = np.maximum(lateral, self.api.mjMINMU)[:, None]

    def _add(self, names: Sequence[str], shapes: Sequence[Sequence[str]], *, free: bool) -> MujocoBody:
        body = MujocoBody(self._simulation, len(self._bodies), names, shapes, free=free)
        self._bodies.append(body)
        self._simulation.parts.append(body)
        self._simulation.restructure()
        return body

    def _declare_pairs(self) -> None:
        """Declare every pair of shapes that may touch."""
        self.close()  # renderers belong to the old model
        for pair in self._spec.pairs:
            self._spec.delete(pair)
        touching = [
            (one.shapes[first], other.shapes[second])
            for one, other in combinations(self._bodies, 2)
            for first, second in product(range(len(one.shapes)), range(len(other.shapes)))
            if one.free or other.free or first or second  # one of the two moves
        ]
        touching += [
            (body.shapes[first + 1], body.shapes[second + 1]) for body in self._bodies for first, second in body.pairs
        ]
        for pair in touching:
            for shape, opposite in product(*pair):
                self._spec.add_pair(geomname1=shape, geomname2=opposite, condim=3, margin=MARGIN)


def _readable(robot: Element) -> tuple[Element, dict[str, bytes]]:
    """A copy of a URDF in a form for MuJoCo, and its meshes by their names in it."""
    robot = copy.deepcopy(robot)
    keep = {"discardvisual": "false", "fusestatic": "false", "balanceinertia": "true", "strippath": "false"}
    ElementTree.SubElement(ElementTree.SubElement(robot, "mujoco"), "compiler", keep)
    for element in robot.iter():
        for key in ("name", "link"):  # a link "world" would become MuJoCo's own
            if element.get(key) == "world":
                element.set(key, "world link")
        if element.tag == "color":  # pictures leave translucent bodies out
            element.set("rgba", " ".join([*element.get("rgba", "").split()[:3], "1"]))
    meshes = {}
    for number, mesh in enumerate(robot.iter("mesh")):
        meshes[f"{number}.stl"] = stl(triangles(Path(mesh.get("filename", ""))))
        mesh.set("filename", f"{number}.stl")
    return robot, meshes


DRAWN = (False, True, False, False, False, False)
"""Groups of geoms that are shown. The floor is not, because pictures draw it, nor are hidden collision shapes."""


class Renderer:
    """Draws the bodies of one model in pictures of one size."""

    def __init__(self, api: Any, model: Any, width: int, height: int) -> None:
        self.model = model
        self.size = width, height
        self._api = api
        self._context = _context(width, height)
        self._context.make_current()
        model.vis.global_.offwidth, model.vis.global_.offheight = self.size
        model.vis.quality.offsamples = 0  # pictures are drawn larger and made smaller, with floor and shadow
        self._drawing = api.MjrContext(model, api.mjtFontScale.mjFONTSCALE_100.value)
        api.mjr_setBuffer(api.mjtFramebuffer.mjFB_OFFSCREEN.value, self._drawing)
        self._scene = api.MjvScene(model, maxgeom=1000)
        self._option = api.MjvOption()
        self._option.geomgroup[:] = DRAWN
        for flag in (api.mjtRndFlag.mjRND_SHADOW, api.mjtRndFlag.mjRND_REFLECTION, api.mjtRndFlag.mjRND_SKYBOX):
            self._scene.flags[flag] = 0

    def __call__(self, data: Any, eye: Eye) -> tuple[NDArray[np.uint8], FloatArray]:
        """As `picture.Renderer`, of the model's state."""
        api, (width, height) = self._api, self.size
        self._context.make_current()
        every = api.mjtCatBit.mjCAT_ALL.value
        api.mjv_updateScene(self.model, data, self._option, None, api.MjvCamera(), every, self._scene)
        edge = eye.near * np.tan(np.radians(eye.field_of_view) / 2)
        for camera in self._scene.camera:  # of both eyes
            camera.pos, camera.forward, camera.up = eye.origin, eye.ahead, eye.up
            camera.frustum_center, camera.frustum_width = 0.0, 0.0  # 0: follows from the picture's sides
            camera.frustum_bottom, camera.frustum_top = -edge, edge
            camera.frustum_near, camera.frustum_far = eye.near, eye.far
        area = api.MjrRect(0, 0, width, height)
        api.mjr_render(area, self._scene, self._drawing)
        colours, depth = np.empty((height, width, 3), np.uint8), np.empty((height, width, 1), np.float32)
        api.mjr_readPixels(colours, depth, area, self._drawing)
        depth = depth[::-1, :, 0]
        away = eye.far * eye.near / (eye.far - (eye.far - eye.near) * depth)
        return colours[::-1], np.where(depth < 1, away, np.float32(np.inf))

    def close(self) -> None:
        self._context.make_current()
        self._drawing.free()
        self._context.free()


def _context(width: int, height: int) -> Any:
    """An OpenGL context. Raises MachineError when the machine offers none."""
    problems = []
    for name in RENDERERS:
        platform = os.environ.pop("PYOPENGL_PLATFORM", None)
        try:
            return import_module(f"mujoco.{name}").GLContext(width, height)
        except (ImportError, AttributeError, OSError, RuntimeError, TypeError) as error:
            problems.append(f"{name}: {error}")
            if platform is not None:
                os.environ["PYOPENGL_PLATFORM"] = platform
    raise MachineError(f"MuJoCo finds no OpenGL for pictures ({'; '.join(problems)})", hint=RENDERER_HINT)
