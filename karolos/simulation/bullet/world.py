"""A PyBullet world."""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from ...core import Array, FloatArray
from ...errors import PluginError
from .. import parts
from ..engines import BULLET
from ..fixtures import read
from ..geometry import Colour, Quaternion, Vector
from ..interface import (
    FLOOR_FRICTION,
    GRAVITY,
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
from ..picture import FLOOR_COLOUR, GRID_COLOUR, GRIDS, SKY_COLOUR, Eye, Marker, draw
from ..shapes import Inertia, Mesh, Shape, inertia_of
from .body import BulletBody, Client
from .motors import BulletMotors

FLOOR_HALF = (5.0, 5.0, 0.5)
"""Half the edges of the slab that is the floor, in m. An infinite plane would be checked against every link at every
substep, at any distance: 8 % of an arm's step."""
HIDDEN_PLACE = (0.0, 0.0, -100.0)
"""A place that no camera sees."""
SOLVER_ROUNDS = 501
"""Largest number of solver iterations per physics step. Only a cube that a strong arm presses needs all of them.
With 301 an iiwa that stands still and presses a cube with 700 N shoots it away at .7 m/s; with 201 it sinks 3 mm."""
SOLVER_RESIDUAL = 3e-4
"""Residual at which the solver stops earlier. An arm at rest sags .6 mm at 1e-4, .9 at 3e-4, 1.8 at 1e-3 (Panda). At
3e-3 a gripper of 20 N closes with 16."""
CONTACT_ERP = 0.5
"""Fraction of a contact's depth that is corrected per physics step. At PyBullet's .2 an arm presses a cube 8 mm deep
into the floor."""
RELEASE_ERP = 0.03
"""The same for objects that leave a moving hand. At .5, and with friction that stays anchored while the gripper opens,
the rest of the pads' pressure decides where the cube goes. If the actions of a trained policy change by .0005, landings
spread by 2 cm (standard deviation), with this value by .7 cm, in MuJoCo by .1 cm."""


_Place = tuple[Vector, Quaternion, list[float]]
"""Position, orientation and joint positions of a body."""


class BulletWorld:
    """Implements `interface.World`.

    Each physics step is a call of its own: with PyBullet's `numSubSteps` torques, contact forces and joint damping are
    those of the whole control step, and motors keep one target speed through it. Forces here are in N.

    The solver iterates until the residual is small, up to `SOLVER_ROUNDS` times. A free arm needs a few rounds, a grip
    all of them. The number depends only on the state, so that an episode repeats bit for bit. With 17 rounds a gripper
    of 20 N closes with 13 N. The number is odd because the order of the constraints alternates, and the gear of the
    fingers must be solved last.

    The floor is a rigid body: as an articulated body without joints it would cost 5 % more. A rigid cube would save
    another 5 %, but keeps state from before it was placed, so that episodes would not repeat bit for bit.

    Args:
        rate: physics steps per second.
        window: whether a window shows the world, with the floor of the pictures.

    Raises MachineError when a window is requested and there is no display.
    """

    def __init__(
        self, *, substeps: int = 10, rate: int = PHYSICS_RATE, window: bool = False, camera: Camera | None = None
    ) -> None:
        self.api = api = Client(window=window)
        self.substeps = substeps
        self.period, self.timestep, self.lead = substeps / rate, 1 / rate, 1 / rate / 2
        api.setPhysicsEngineParameter(
            fixedTimeStep=self.timestep,
            numSubSteps=0,
            numSolverIterations=SOLVER_ROUNDS,
            solverResidualThreshold=SOLVER_RESIDUAL,
            contactERP=CONTACT_ERP,
            deterministicOverlappingPairs=1,  # contacts in the same order, fresh or reused: resume depends on it
        )
        if window:
            camera = camera or Camera()
            sky = [level / 255 for level in SKY_COLOUR]
            api.configureDebugVisualizer(api.COV_ENABLE_GUI, 0, rgbBackground=sky)
            api.resetDebugVisualizerCamera(camera.distance, camera.yaw, camera.pitch, camera.target)
        self.set_gravity(GRAVITY)
        self._markers: list[tuple[BulletBody, float, Colour]] = []
        self._pictured: list[_Place] = []
        """Positions of bodies and joints in the last picture of a present state."""
        self._double: BulletWorld | None = None
        """A second world for pictures between states. Writing and restoring states here would change the simulation."""
        self._made: list[Callable[[BulletWorld], object]] = []
        self._motors: list[BulletMotors] = []
        self._free: list[BulletBody] = []
        self._stepped = False
        self._peaks: dict[int, dict[tuple[int, int], float]] = {}
        """Largest forces on the bodies that were asked about, see `forces`."""
        self._window = window
        self.floor = self._create(
            api.createCollisionShape(
                api.GEOM_BOX, halfExtents=FLOOR_HALF, collisionFramePosition=(0, 0, -FLOOR_HALF[2])
            ),
            self._floor_look(),
            0.0,
        )
        self.set_floor_friction(FLOOR_FRICTION)

    def step(self) -> None:
        self._stepped = True
        self._peaks = {body: {} for body in self._peaks}
        for substep in range(self.substeps):
            for motors in self._motors:
                motors.substep(substep)
            self.api.stepSimulation()
            for motors in self._motors:
                if motors.feels:
                    motors.feel()
            for body, peaks in self._peaks.items():
                now = self._forces(body)
                self._peaks[body] = {key: max(peaks.get(key, 0.0), now.get(key, 0.0)) for key in (*peaks, *now)}
        for motors in self._motors:
            recorded = self._peaks.get(motors.index)
            motors.record(self._forces(motors.index) if recorded is None else recorded)

    def set_gravity(self, gravity: float) -> None:
        self.api.setGravity(0, 0, gravity)

    def set_floor_friction(self, friction: float) -> None:
        self.floor.set_friction(friction)

    def load(self, source: Path | Mechanism, *, position: Vector = (0.0, 0.0, 0.0)) -> BulletBody:
        self._made.append(lambda world: world.load(source, position=position))
        mechanism = read(source) if isinstance(source, Path) else source
        body = BulletBody(self.api, self._load(mechanism.robot, fixed=True, position=position))
        if mechanism.frictions or mechanism is not source:  # not an arm
            body.collide_only(())
            for link in (-1, *body.links().values()):
                body.change(link, collisionMargin=0.0)
        for name, friction in mechanism.frictions.items():
            body.drive_joint(name, 0.0, friction)
        return body

    def _load(self, robot: Element, *, fixed: bool, maximal: bool = False, position: Vector = (0.0, 0.0, 0.0)) -> int:
        robot = copy.deepcopy(robot)
        with tempfile.TemporaryDirectory() as folder:
            for number, mesh in enumerate(robot.iter("mesh")):
                file = Path(folder, f"{number}.stl")
                file.write_bytes(stl(triangles(Path(mesh.get("filename", "")))))
                mesh.set("filename", str(file))
            ElementTree.indent(robot)  # PyBullet breaks lines of more than 1,024 characters
            path = Path(folder, "robot.urdf")
            path.write_bytes(ElementTree.tostring(robot))
            try:
                index: int = self.api.loadURDF(
                    str(path),
                    basePosition=position,
                    useFixedBase=fixed,
                    useMaximalCoordinates=maximal,
                    # inertias would otherwise be guessed from the shapes; `Body.collide_only` chooses the pairs
                    flags=self.api.URDF_USE_INERTIA_FROM_FILE | self.api.URDF_USE_SELF_COLLISION,
                )
            except self.api.error as error:
                what = f"pybullet cannot load this URDF: {error}"
                raise PluginError(what, where=f"robot {robot.get('name', '?')}") from error
        return index

    def motors(
        self,
        body: Body,
        joints: Sequence[str],
        limits: JointLimits,
        fingers: Fingers | None,
        tool: Frame | None = None,
        cup: Cup | None = None,
    ) -> BulletMotors:
        if cup is not None:
            raise BULLET.lacks("suction")
        links = body.links()
        pads = [links[name] for name in fingers.links] if fingers else []
        arm = [links[name] for name in joints]
        motors = BulletMotors(
            BulletBody(self.api, body.index),
            self.substeps,
            limits,
            arm,
            fingers,
            pads,
            timestep=self.timestep,
            tool=tool,
        )
        self._motors.append(motors)
        return motors

    def release_in_motion(self) -> None:
        for motors in self._motors:
            motors.release_in_motion()
        self.api.setPhysicsEngineParameter(contactERP=RELEASE_ERP)

    def body(self, shapes: Sequence[Shape], mass: float, colour: Colour, inertia: Inertia | None = None) -> BulletBody:
        self._made.append(lambda world: world.body(shapes, mass, colour, inertia))
        own = (inertia or inertia_of(shapes, mass)) if mass > 0 else None
        index = self._load(parts.body(shapes, mass, own), fixed=mass == 0, maximal=mass == 0)
        self.api.changeVisualShape(index, -1, rgbaColor=colour)
        body = BulletBody(self.api, index, own)
        body.let_drift()
        if any(isinstance(shape, Mesh) for shape in shapes):
            body.change(-1, collisionMargin=0.0)  # PyBullet would keep 1 mm around a mesh
        if mass > 0:
            self._free.append(body)
        return body

    def marker(self, radius: float, colour: Colour) -> BulletBody:
        self._made.append(lambda world: world.marker(radius, colour))
        # pictures draw markers themselves
        look = self.api.createVisualShape(self.api.GEOM_SPHERE, rgbaColor=colour, radius=radius) if self._window else -1
        marker = self._create(-1, look, 0.0)
        self._markers.append((marker, radius, colour))
        return marker

    def forget_contacts(self) -> None:
        # PyBullet forgets a contact, which would warm-start the solver, when it detects that the bodies are apart
        if not self._stepped:  # a detection before the first step would change the order of contacts
            return
        self._stepped = False
        api = self.api
        poses = [api.getBasePositionAndOrientation(body.index) for body in self._free]  # `pose` might round
        for number, body in enumerate(self._free):
            body.place((0.0, 0.0, 10.0 + number))
        api.performCollisionDetection()
        for body, (position, orientation) in zip(self._free, poses, strict=True):
            api.resetBasePositionAndOrientation(body.index, position, orientation)

    def contacts(self, first: Body, second: Body, link: int) -> list[Contact]:
        points = self.api.getContactPoints(first.index, second.index, linkIndexA=link)
        return [Contact(point[7], point[9], point[8]) for point in points or ()]

    def forces(self, body: Body) -> dict[tuple[int, int], float]:
        # recorded from the first call on, because reading them in each physics step costs some us
        return self._peaks.setdefault(body.index, self._forces(body.index) if self._stepped else {})

    def largest_forces(self, body: Body) -> dict[tuple[int, int], float]:
        return next((motors.largest for motors in self._motors if motors.index == body.index), {})

    def _forces(self, body: int) -> dict[tuple[int, int], float]:
        """As `forces`, of the last physics step."""
        found: dict[tuple[int, int], float] = {}
        for _, _, other, link, opposite, *_, force in (point[:10] for point in self.api.getContactPoints(body) or ()):
            for one in (link, opposite) if other == body else (link,):
                if force > 0:
                    found[one, other] = found.get((one, other), 0.0) + force
        return found

    def render(
        self, width: int, height: int, camera: Camera, strokes: Sequence[Stroke] = (), back: float = 0.0
    ) -> Array:
        if not back:
            self._pictured = self._places()
            return self._picture(width, height, camera, strokes)
        if self._double is None:
            self._double = BulletWorld()
            for make in self._made:
                make(self._double)
        now = self._places()
        before = self._pictured if len(self._pictured) == len(now) else now
        self._double._stand(before, now, back)
        return self._double._picture(width, height, camera, strokes)

    def _places(self) -> list[_Place]:
        """Contacts of each body."""
        api = self.api
        indices = map(api.getBodyUniqueId, range(api.getNumBodies()))
        return [
            (
                *api.getBasePositionAndOrientation(body),
                [api.getJointState(body, joint)[0] for joint in range(api.getNumJoints(body))],
            )
            for body in indices
        ]

    def _stand(self, before: list[_Place], now: list[_Place], back: float) -> None:
        """Move every body to a place between two states, this share of the way before the second."""
        api = self.api
        for place, (old, new) in enumerate(zip(before, now, strict=True)):
            body = api.getBodyUniqueId(place)
            position = [own + back * (was - own) for was, own in zip(old[0], new[0], strict=True)]
            api.resetBasePositionAndOrientation(body, position, api.getQuaternionSlerp(new[1], old[1], back))
            for joint, (was, own) in enumerate(zip(old[2], new[2], strict=True)):
                api.resetJointState(body, joint, own + back * (was - own))

    def _picture(self, width: int, height: int, camera: Camera, strokes: Sequence[Stroke]) -> Array:
        markers = [Marker(body.pose()[0], radius, colour) for body, radius, colour in self._markers]
        return draw(self._render_bodies, width, height, camera, markers, strokes)

    def _render_bodies(self, eye: Eye, width: int, height: int) -> tuple[NDArray[np.uint8], FloatArray]:
        """PyBullet's software renderer, which needs no display."""
        aim = [own + step for own, step in zip(eye.origin, eye.ahead, strict=True)]
        image = self.api.getCameraImage(
            width,
            height,
            self.api.computeViewMatrix(eye.origin, aim, eye.up),
            self.api.computeProjectionMatrixFOV(eye.field_of_view, width / height, eye.near, eye.far),
            lightDirection=(1.5, -1.4, 3.0),
            lightColor=(1.0, 0.99, 0.97),
            lightAmbientCoeff=0.52,
            lightDiffuseCoeff=0.4,
            lightSpecularCoeff=0.05,
            shadow=0,
            renderer=self.api.ER_TINY_RENDERER,
        )
        colours, depth, bodies = (np.asarray(part).reshape(height, width, -1) for part in image[2:5])
        away = eye.far * eye.near / (eye.far - (eye.far - eye.near) * depth[..., 0].astype(np.float32))
        return colours[..., :3].astype(np.uint8), np.where(bodies[..., 0] >= 0, away, np.float32(np.inf))

    def _floor_look(self) -> Any:
        """The visual shape of the floor in a window. Pictures draw their own floor."""
        api = self.api
        half, place, colour = (1e-3,) * 3, HIDDEN_PLACE, (0.0, 0.0, 0.0)  # needed: else it shows collisions
        if self._window:
            spacing, _, _ = GRIDS[-1]
            lines = [level / 255 for level in GRID_COLOUR]
            for at in (spacing * line for line in range(-10, 11)):
                api.addUserDebugLine((at, -10 * spacing, 0.001), (at, 10 * spacing, 0.001), lineColorRGB=lines)
                api.addUserDebugLine((-10 * spacing, at, 0.001), (10 * spacing, at, 0.001), lineColorRGB=lines)
            half, place, colour = FLOOR_HALF, (0, 0, -FLOOR_HALF[2]), FLOOR_COLOUR
        rgba = [*(level / 255 for level in colour), 1.0]
        return api.createVisualShape(api.GEOM_BOX, rgbaColor=rgba, halfExtents=half, visualFramePosition=place)

    def close(self) -> None:
        if self._double is not None:
            self._double.close()
        self.api.close()

    def _create(self, shape: int, look: int, mass: float) -> BulletBody:
        index: int = self.api.createMultiBody(mass, shape, look, useMaximalCoordinates=mass == 0)
        return BulletBody(self.api, index)
