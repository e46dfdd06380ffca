"""The physics world: the only place that knows pybullet.

Units: m, s, kg, N, rad; quaternions x y z w. z points up, the floor is z = 0.
"""

from __future__ import annotations

import importlib
import os
import sys
import tempfile
from threading import Lock
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from ..core import Array
from ..errors import MachineError, PluginError
from .body import Body, Colour, Vector
from .camera import Camera, picture

GRAVITY = -9.81
"""m/s2 along z."""
FLOOR_FRICTION = 0.5
"""Lateral friction of the floor; PyBullet multiplies the coefficients of the two bodies in contact."""

FLOOR_HALF = (5.0, 5.0, 0.5)
"""Half the edges of the slab that is the floor, in m. An endless plane would be checked against every link at every
substep, wherever they are: 8 % of an arm's step."""
_IMPORTING = Lock()


def _pybullet() -> Any:
    """The module, imported here and nowhere else, so that specs are checked without it.

    It greets with its build time on stderr, once per worker, in the middle of a progress bar: not heard.
    """
    with _IMPORTING:
        if "pybullet" in sys.modules:
            return sys.modules["pybullet"]
        kept = os.dup(2)
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        try:
            importlib.import_module("pybullet")
        finally:
            os.dup2(kept, 2)
            os.close(kept)
        return sys.modules["pybullet"]


class World:
    """A floor, gravity and whatever is put in. Built once; an episode begins by writing states, never by loading.

    A control step is `substeps` physics steps of `timestep` seconds in one call.

    Measured (PyBullet 3.2.7): ten substeps in one call cost 5 % less than ten calls. The solver stops iterating at a
    residual of 1e-4 or after 17 rounds. An odd number: the order of the constraints alternates from round to round, and
    the gear of the fingers should have the last word. Creep of a gripped cube in a 1 s shake and largest difference of
    the fingers, worst of three robots: 13 rounds .8 and .5 mm, 16 rounds .4 and 3.4 mm, 17 rounds .6 and .4 mm, 50
    rounds .3 and .4 mm for twice the time.

    The floor is a rigid body: as an articulated one without joints it would cost 5 % more. A cube as one would save as
    much again, but keeps something of the step before its placing, and episodes would not repeat bit for bit.

    Raises MachineError when a window is asked for and there is no display.
    """

    def __init__(self, *, substeps: int = 10, timestep: float = 1 / 240, window: bool = False) -> None:
        if window and sys.platform == "linux" and not os.environ.get("DISPLAY"):  # pybullet would end the process
            raise MachineError("no display to show a window on", hint="set DISPLAY, or do without a window")
        pybullet = _pybullet()
        self.api = pybullet
        self.substeps = substeps
        self.timestep = timestep
        self.period = substeps * timestep
        self.client: int = pybullet.connect(pybullet.GUI if window else pybullet.DIRECT)
        if self.client < 0:
            raise MachineError("the physics engine does not start", hint="too many worlds, or no display for a window")
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=self.period,
            numSubSteps=substeps if substeps > 1 else 0,
            numSolverIterations=17,
            solverResidualThreshold=1e-4,
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
        slab = pybullet.createVisualShape(
            pybullet.GEOM_BOX,
            halfExtents=(0.9, 0.9, 0.01),
            rgbaColor=(0.62, 0.68, 0.74, 1.0),
            visualFramePosition=(0.3, 0.0, -0.01),
            physicsClientId=self.client,
        )
        self.floor = self._create(
            self._shape(pybullet.GEOM_BOX, halfExtents=FLOOR_HALF, collisionFramePosition=(0, 0, -FLOOR_HALF[2])),
            slab,
            0.0,
        )
        self.set_floor_friction(FLOOR_FRICTION)

    def step(self) -> None:
        """One control step: `period` seconds."""
        self.api.stepSimulation(physicsClientId=self.client)

    def set_gravity(self, gravity: float) -> None:
        """Gravity along z in m/s2; negative pulls down."""
        self.api.setGravity(0, 0, gravity, physicsClientId=self.client)

    def set_floor_friction(self, friction: float) -> None:
        self.floor.set_friction(friction)

    def load(self, robot: Element, *, position: Vector = (0.0, 0.0, 0.0)) -> Body:
        """Put in what a URDF's <robot> describes, its base fixed. Raises PluginError when pybullet refuses it."""
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

    def box(self, size: Vector, mass: float, colour: Colour) -> Body:
        """A box with edges of `size` in m; a mass of 0 kg stands still."""
        half = tuple(edge / 2 for edge in size)
        shape = self._shape(self.api.GEOM_BOX, halfExtents=half)
        return self._create(shape, self._look(self.api.GEOM_BOX, colour, halfExtents=half), mass)

    def sphere(self, radius: float, mass: float, colour: Colour) -> Body:
        shape = self._shape(self.api.GEOM_SPHERE, radius=radius)
        return self._create(shape, self._look(self.api.GEOM_SPHERE, colour, radius=radius), mass)

    def marker(self, radius: float, colour: Colour) -> Body:
        """A sphere that is only seen, half through: nothing touches it."""
        marker = self._create(-1, self._look(self.api.GEOM_SPHERE, colour, radius=radius), 0.0)
        self._markers.append(marker)
        return marker

    def show_floor(self, low: tuple[float, float], high: tuple[float, float]) -> None:
        """Show the floor from `low` to `high` (x, y in m) too; it is there for 5 m around without being seen."""
        half = ((high[0] - low[0]) / 2, (high[1] - low[1]) / 2, 0.01)
        look = self._look(self.api.GEOM_BOX, (0.62, 0.68, 0.74, 1.0), halfExtents=half)
        centre = (low[0] + half[0], low[1] + half[1], -half[2] - 0.001)  # below what is shown anyway: no flicker
        self._create(-1, look, 0.0).place(centre)

    def find_contacts(self) -> None:
        """Find contacts anew without a step: what no longer touches is forgotten, with the impulses it held."""
        self.api.performCollisionDetection(physicsClientId=self.client)

    def touching(self, first: Body, second: Body, link: int) -> bool:
        """Whether `link` of the first body is in contact with the second."""
        contacts = self.api.getContactPoints(first.index, second.index, linkIndexA=link, physicsClientId=self.client)
        return bool(contacts)

    def render(self, width: int, height: int, camera: Camera) -> Array:
        """A picture (height, width, 3) uint8."""
        size = (width, height)
        solid = picture(self.api, self.client, size, camera)
        if not self._markers:
            return solid
        # the renderer knows no opacity: mix with a picture that the markers are missing from
        places = [marker.pose()[0] for marker in self._markers]
        for marker in self._markers:
            marker.place((0.0, 0.0, -100.0))
        without = picture(self.api, self.client, size, camera)
        for marker, position in zip(self._markers, places, strict=True):
            marker.place(position)
        mixed: Array = (0.6 * solid + 0.4 * without).astype(np.uint8)
        return mixed

    def close(self) -> None:
        """Free the world. Safe to call twice."""
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
