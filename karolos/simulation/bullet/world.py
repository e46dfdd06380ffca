"""A PyBullet world."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Sequence
from threading import Lock
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from ...core import Array
from ...errors import MachineError, PluginError
from ..geometry import Vector
from ..interface.engine import FLOOR_FRICTION, GRAVITY, Camera, Colour, Contact, Fingers, JointLimits
from ..interface.engine import Body as AnyBody
from .body import Body
from .motors import Motors

FLOOR_HALF = (5.0, 5.0, 0.5)
"""Half the edges of the slab that is the floor, in m. An endless plane would be checked against every link at every
substep, wherever they are: 8 % of an arm's step."""
FLOOR_COLOUR = (0.62, 0.68, 0.74, 1.0)
SKY_TOP, SKY_BOTTOM = (168.0, 186.0, 206.0), (232.0, 236.0, 240.0)
ROUNDS = 201
"""Largest number of the solver's iterations per physics step."""
RESIDUAL = 1e-3
"""Residual at which the solver stops earlier. At 1e-4 a step with a gripped cube takes 1.4 times as long, at 3e-3 a
gripper of 20 N closes with 16."""
CONTACT_ERP = 0.5
"""Fraction of a contact's depth that is corrected per physics step. At PyBullet's .2 an arm presses a cube 8 mm deep
into the floor."""
_IMPORTING = Lock()


def _pybullet() -> Any:
    """The module, imported when a world is built, so that specs are checked without it.

    PyBullet prints its build time on stderr at import, which would interrupt progress bars: stderr is closed meanwhile.
    """
    with _IMPORTING:
        if "pybullet" in sys.modules:
            return sys.modules["pybullet"]
        stderr = os.dup(2)
        with open(os.devnull, "wb") as devnull:
            os.dup2(devnull.fileno(), 2)
        try:
            import pybullet  # noqa: PLC0415
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
        return pybullet


class World:
    """Implements `interface.World`; a control step is `substeps` physics steps of `timestep` seconds.

    Each physics step is a call of its own: with PyBullet's `numSubSteps` torques, contact forces and joint damping are
    those of the whole control step, and motors keep one target speed through it. Forces here are in N.

    The solver iterates until the residual is small, up to `ROUNDS` times. A free arm needs a few rounds, a grip needs
    all of them. Their number follows from the state alone, so that an episode repeats bit for bit. With 17 rounds a
    gripper of 20 N closes with 13 N. The number is odd because the order of the constraints alternates, and the gear of
    the fingers has to be solved last.

    The floor is a rigid body: as an articulated one without joints it would cost 5 % more. A rigid cube would save as
    much again, but keeps state from before it was placed, so that episodes would not repeat bit for bit.

    Raises MachineError when a window is requested and there is no display.
    """

    def __init__(self, *, substeps: int = 10, timestep: float = 1 / 240, window: bool = False) -> None:
        if window and sys.platform == "linux" and not os.environ.get("DISPLAY"):  # pybullet would end the process
            raise MachineError("no display to show a window on", hint="set DISPLAY, or run without a window")
        pybullet = _pybullet()
        self.api = pybullet
        self.substeps = substeps
        self.timestep = timestep
        self.period = substeps * timestep
        self.client: int = pybullet.connect(pybullet.GUI if window else pybullet.DIRECT)
        if self.client < 0:
            raise MachineError("the physics engine does not start", hint="too many worlds, or no display for a window")
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=timestep,
            numSubSteps=0,
            numSolverIterations=ROUNDS,
            solverResidualThreshold=RESIDUAL,
            contactERP=CONTACT_ERP,
            deterministicOverlappingPairs=1,  # contacts in the same order, fresh or reused: resume depends on it
            physicsClientId=self.client,
        )
        if window:
            look = Camera()
            pybullet.configureDebugVisualizer(pybullet.COV_ENABLE_GUI, 0, physicsClientId=self.client)
            pybullet.resetDebugVisualizerCamera(
                look.distance, look.yaw, look.pitch, look.target, physicsClientId=self.client
            )
        self.set_gravity(GRAVITY)
        self._markers: list[Body] = []
        self._motors: list[Motors] = []
        half, place = (0.9, 0.9, 0.01), (0.3, 0.0, -0.01)
        slab = self._look(pybullet.GEOM_BOX, FLOOR_COLOUR, halfExtents=half, visualFramePosition=place)
        self.floor = self._create(
            self._shape(pybullet.GEOM_BOX, halfExtents=FLOOR_HALF, collisionFramePosition=(0, 0, -FLOOR_HALF[2])),
            slab,
            0.0,
        )
        self.set_floor_friction(FLOOR_FRICTION)

    def step(self) -> None:
        for substep in range(self.substeps):
            for motors in self._motors:
                motors.substep(substep)
            self.api.stepSimulation(self.client)

    def set_gravity(self, gravity: float) -> None:
        self.api.setGravity(0, 0, gravity, physicsClientId=self.client)

    def set_floor_friction(self, friction: float) -> None:
        self.floor.set_friction(friction)

    def load(self, robot: Element, *, position: Vector = (0.0, 0.0, 0.0)) -> Body:
        handle, path = tempfile.mkstemp(suffix=".urdf")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(ElementTree.tostring(robot))
            index: int = self.api.loadURDF(
                path,
                basePosition=position,
                useFixedBase=True,
                # inertias would otherwise be guessed from the shapes; `Body.collide_only` chooses the pairs
                flags=self.api.URDF_USE_INERTIA_FROM_FILE | self.api.URDF_USE_SELF_COLLISION,
                physicsClientId=self.client,
            )
        except self.api.error as error:
            raise PluginError(
                f"pybullet cannot load this URDF: {error}", where=f"robot {robot.get('name', '?')}"
            ) from error
        finally:
            os.unlink(path)
        return Body(self.api, self.client, index)

    def motors(self, body: AnyBody, joints: Sequence[str], limits: JointLimits, fingers: Fingers | None) -> Motors:
        links = body.links()
        pads = [links[name] for name in fingers.links] if fingers else []
        own = Body(self.api, self.client, body.index)
        motors = Motors(own, self.substeps, limits, [links[name] for name in joints], fingers, pads)
        self._motors.append(motors)
        return motors

    def box(self, size: Vector, mass: float, colour: Colour) -> Body:
        half = tuple(edge / 2 for edge in size)
        shape = self._shape(self.api.GEOM_BOX, halfExtents=half)
        body = self._create(shape, self._look(self.api.GEOM_BOX, colour, halfExtents=half), mass)
        body.set_air_drag(0.0)
        return body

    def marker(self, radius: float, colour: Colour) -> Body:
        marker = self._create(-1, self._look(self.api.GEOM_SPHERE, colour, radius=radius), 0.0)
        self._markers.append(marker)
        return marker

    def show_floor(self, low: tuple[float, float], high: tuple[float, float]) -> None:
        half = ((high[0] - low[0]) / 2, (high[1] - low[1]) / 2, 0.01)
        look = self._look(self.api.GEOM_BOX, FLOOR_COLOUR, halfExtents=half)
        # 1 mm below the slab that is always drawn: overlapping surfaces would flicker
        self._create(-1, look, 0.0).place((low[0] + half[0], low[1] + half[1], -half[2] - 0.001))

    def update_contacts(self) -> None:
        self.api.performCollisionDetection(physicsClientId=self.client)

    def contacts(self, first: AnyBody, second: AnyBody, link: int) -> list[Contact]:
        points = self.api.getContactPoints(first.index, second.index, linkIndexA=link, physicsClientId=self.client)
        return [Contact(point[7], point[9]) for point in points or ()]

    def render(self, width: int, height: int, camera: Camera) -> Array:
        solid = self._picture(width, height, camera)
        if not self._markers:
            return solid
        # the renderer has no opacity: mix with a picture without the markers
        places = [marker.pose()[0] for marker in self._markers]
        for marker in self._markers:
            marker.place((0.0, 0.0, -100.0))
        without = self._picture(width, height, camera)
        for marker, position in zip(self._markers, places, strict=True):
            marker.place(position)
        mixed: Array = (0.6 * solid + 0.4 * without).astype(np.uint8)
        return mixed

    def _picture(self, width: int, height: int, camera: Camera) -> Array:
        """A picture by PyBullet's software renderer, which needs no display and has no antialiasing."""
        view = self.api.computeViewMatrixFromYawPitchRoll(
            camera.target, camera.distance, camera.yaw, camera.pitch, 0.0, 2, physicsClientId=self.client
        )
        projection = self.api.computeProjectionMatrixFOV(camera.field_of_view, width / height, 0.1, 10.0)
        image = self.api.getCameraImage(
            width,
            height,
            view,
            projection,
            lightDirection=(1.5, -1.4, 3.0),
            lightDistance=3.5,
            lightColor=(1.0, 0.99, 0.97),
            lightAmbientCoeff=0.6,
            lightDiffuseCoeff=0.42,
            lightSpecularCoeff=0.05,
            shadow=1,
            renderer=self.api.ER_TINY_RENDERER,
            physicsClientId=self.client,
        )
        pixels: Array = np.asarray(image[2], np.uint8).reshape(height, width, 4)[..., :3].copy()
        background = np.asarray(image[4]).reshape(height, width) < 0
        sky = np.linspace(SKY_TOP, SKY_BOTTOM, height).astype(np.uint8)
        pixels[background] = np.broadcast_to(sky[:, None], pixels.shape)[background]
        return pixels

    def close(self) -> None:
        if self.client >= 0:
            self.api.disconnect(physicsClientId=self.client)
            self.client = -1

    def _shape(self, kind: int, **size: object) -> int:
        index: int = self.api.createCollisionShape(kind, physicsClientId=self.client, **size)
        return index

    def _look(self, kind: int, colour: Colour, **size: object) -> int:
        index: int = self.api.createVisualShape(kind, rgbaColor=colour, physicsClientId=self.client, **size)
        return index

    def _create(self, shape: int, look: int, mass: float) -> Body:
        index: int = self.api.createMultiBody(
            mass, shape, look, useMaximalCoordinates=mass == 0, physicsClientId=self.client
        )
        return Body(self.api, self.client, index)
