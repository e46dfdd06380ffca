"""One body of a PyBullet world, with its pose, joints and material; PyBullet's functions for one world."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection, Sequence
from functools import cached_property, partial
from threading import Lock
from typing import Any

import numpy as np

from ...errors import MachineError
from ...system import has_display
from ..engines import BULLET
from ..geometry import UPRIGHT, Quaternion, Vector
from ..interface import LinkState, Material
from ..shapes import Inertia


class BulletBody:
    """Implements `interface.Body`. Most methods are a single pybullet call of 1 to 3 us.

    PyBullet's pose of a base is that of its centre of mass and principal axes.

    Args:
        inertia: of a base whose own frame differs.
    """

    def __init__(self, api: Client, index: int, inertia: Inertia | None = None) -> None:
        self.api = api
        self.index = index
        self._inertial: tuple[Vector, Quaternion] | None = None
        if inertia is not None and (any(inertia.centre) or inertia.axes != UPRIGHT):
            self._inertial = inertia.centre, inertia.axes
            self._own = api.invertTransform(*self._inertial)

    def links(self) -> dict[str, int]:
        count = self.api.getNumJoints(self.index)
        infos = [self.api.getJointInfo(self.index, joint) for joint in range(count)]
        return {info[12].decode(): index for index, info in enumerate(infos)}

    def collide_only(self, pairs: Collection[tuple[int, int]]) -> None:
        count = self.api.getNumJoints(self.index)
        for first in range(-1, count):
            for second in range(first + 1, count):
                enabled = (first, second) in pairs or (second, first) in pairs
                self.api.setCollisionFilterPair(self.index, self.index, first, second, enabled)

    def place(self, position: Vector, orientation: Quaternion = UPRIGHT) -> None:
        if self._inertial is not None:
            position, orientation = self.api.multiplyTransforms(position, orientation, *self._inertial)
        self.api.resetBasePositionAndOrientation(self.index, position, orientation)
        self.api.resetBaseVelocity(self.index, (0, 0, 0), (0, 0, 0))

    def pose(self) -> tuple[Vector, Quaternion]:
        position, orientation = self.api.getBasePositionAndOrientation(self.index)
        if self._inertial is not None:
            position, orientation = self.api.multiplyTransforms(position, orientation, *self._own)
        return position, orientation

    def velocity(self) -> tuple[Vector, Vector]:
        linear, angular = self.api.getBaseVelocity(self.index)
        if self._inertial is not None:
            centre, _ = self.api.getBasePositionAndOrientation(self.index)
            away = np.subtract(self.pose()[0], centre)
            linear = tuple((linear + np.cross(angular, away)).tolist())
        return linear, angular

    def set_velocity(self, velocity: Vector) -> None:
        self.api.resetBaseVelocity(self.index, velocity, (0, 0, 0))

    def link(self, link: int) -> LinkState:
        state = self.api.getLinkState(self.index, link, 1, 1)
        return LinkState(state[4], state[5], state[6], state[7], state[0])

    def joints(self, joints: Sequence[int]) -> tuple[tuple[float, float, Any, float], ...]:
        states: tuple[tuple[float, float, Any, float], ...] = self.api.getJointStates(self.index, joints)
        return states

    @cached_property
    def _named(self) -> dict[str, int]:
        """Index of each joint by name."""
        count = self.api.getNumJoints(self.index)
        return {self.api.getJointInfo(self.index, joint)[1].decode(): joint for joint in range(count)}

    def joint(self, name: str) -> tuple[float, float]:
        position, velocity, *_ = self.api.getJointState(self.index, self._named[name])
        return position, velocity

    def place_joint(self, name: str, position: float) -> None:
        self.api.resetJointState(self.index, self._named[name], position, 0.0)

    def drive_joint(self, name: str, speed: float, force: float) -> None:
        mode = self.api.VELOCITY_CONTROL
        self.api.setJointMotorControl2(self.index, self._named[name], mode, targetVelocity=speed, force=force)

    def set_joint_damping(self, name: str, damping: float) -> None:
        self.change(self._named[name], jointDamping=damping)

    def set_friction(self, lateral: float, link: int = -1) -> None:
        self.change(link, lateralFriction=lateral)

    def set_material(self, material: Material, link: int = -1) -> None:  # noqa: ARG002 (whatever they are)
        raise BULLET.lacks("materials")

    def set_inertia(self, mass: float, diagonal: Vector, link: int = -1) -> None:
        # with the mass alone pybullet would guess the inertia from the shape
        self.change(link, mass=mass, localInertiaDiagonal=diagonal)

    def let_drift(self, link: int = -1) -> None:
        """Switch off PyBullet's damping of a link's velocity, .04 per s by default."""
        self.change(link, linearDamping=0.0, angularDamping=0.0)

    def change(self, link: int, **dynamics: Any) -> None:
        """Set PyBullet's dynamics of a link."""
        self.api.changeDynamics(self.index, link, **dynamics)


_IMPORTING = Lock()


def _pybullet() -> Any:
    """The module, imported when a world is built, so that specs are checked without it.

    PyBullet prints its build time on stderr at import, which would interrupt progress bars. So stderr is
    closed during the import.
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


class Client:
    """A connection to PyBullet: its attributes are PyBullet's, and functions act in the world of this connection.

    Raises MachineError when a window is requested and there is no display.
    """

    def __init__(self, *, window: bool) -> None:
        if window and not has_display():  # pybullet would end the process
            raise MachineError("no display to show a window on", hint="set DISPLAY, or run without a window")
        self._module = pybullet = _pybullet()
        self._number = pybullet.connect(pybullet.GUI if window else pybullet.DIRECT)
        if self._number < 0:
            raise MachineError("the physics engine does not start", hint="too many worlds, or no display for a window")

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # also if a copy asks before the module exists
            raise AttributeError(name)
        found = getattr(self._module, name)
        if callable(found) and not isinstance(found, type):
            found = partial(found, physicsClientId=self._number)
        setattr(self, name, found)  # looked up once
        return found

    def close(self) -> None:
        """Free the world. A second call has no effect."""
        if self._number >= 0:
            self.disconnect()
            self._number = -1
