"""One body of a PyBullet world: its pose, its joints, its material."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from ..engines import BULLET
from ..geometry import UPRIGHT, Quaternion, Vector
from ..interface.engine import LinkState, Material
from ..shapes import Inertia
from .client import Client


class BulletBody:
    """Implements `interface.Body`. Most methods are a single pybullet call of 1 to 3 us.

    PyBullet's pose of a base is that of its centre of mass and principal axes.

    Args:
        inertia: of a base whose own frame is another.
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
