"""One body of a PyBullet world: its pose, its joints, its material."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from ...core import Array
from ..geometry import UPRIGHT, Quaternion, Vector
from ..interface.engine import LinkState
from .client import Client


class Body:
    """Implements `interface.Body`. Most methods are a single pybullet call of 1 to 3 us."""

    def __init__(self, api: Client, index: int) -> None:
        self.api = api
        self.index = index

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
        self.api.resetBasePositionAndOrientation(self.index, position, orientation)
        self.api.resetBaseVelocity(self.index, (0, 0, 0), (0, 0, 0))

    def pose(self) -> tuple[Vector, Quaternion]:
        position, orientation = self.api.getBasePositionAndOrientation(self.index)
        return position, orientation

    def velocity(self) -> tuple[Vector, Vector]:
        linear, angular = self.api.getBaseVelocity(self.index)
        return linear, angular

    def link(self, link: int, *, moved: bool = False) -> LinkState:
        state = self.api.getLinkState(self.index, link, 1, moved)
        return LinkState(state[4], state[5], state[6], state[7], state[0])

    def joints(self, joints: Sequence[int]) -> tuple[tuple[float, float, Any, float], ...]:
        states: tuple[tuple[float, float, Any, float], ...] = self.api.getJointStates(self.index, joints)
        return states

    def write_joints(
        self, joints: Sequence[int], positions: Sequence[float], velocities: Sequence[float] | None = None
    ) -> None:
        """Set joint states without a physics step; at rest by default."""
        self.api.resetJointStatesMultiDof(
            self.index,
            joints,
            [(position,) for position in positions],
            [(velocity,) for velocity in velocities] if velocities else [(0.0,)] * len(joints),
        )

    def limit_motor_speed(self, joint: int, velocity: float) -> None:
        """Limit the speed that the joint's motor asks for (rad/s or m/s). Later calls of `drive_...` keep the limit."""
        self.api.setJointMotorControl2(
            self.index, joint, self.api.POSITION_CONTROL, targetPosition=0.0, force=0.0, maxVelocity=velocity
        )

    def drive_position(self, joint: int, position: float, force: float, gain: float) -> None:
        """Aim one motor at a position (rad or m) until the next call.

        Args:
            force: largest torque or force of the motor in N m or N.
            gain: fraction of the distance to the position that the motor asks for per physics step.
        """
        self.api.setJointMotorControl2(
            self.index,
            joint,
            self.api.POSITION_CONTROL,
            targetPosition=position,
            force=force,
            positionGain=gain,
            velocityGain=1.0,
        )

    def drive_speeds(
        self, joints: Sequence[int], velocities: Sequence[float], forces: Sequence[float], gains: Sequence[float]
    ) -> None:
        """Aim the motors at velocities (rad/s or m/s) until the next call.

        Args:
            forces: largest torque or force of each motor in N m or N.
            gains: fraction of the difference from its velocity that a motor removes per physics step, in (0, 1].
        """
        self.api.setJointMotorControlArray(
            self.index,
            joints,
            self.api.VELOCITY_CONTROL,
            targetVelocities=velocities,
            forces=forces,
            velocityGains=gains,
        )

    def set_friction(self, lateral: float, link: int = -1) -> None:
        self.api.changeDynamics(self.index, link, lateralFriction=lateral)

    def couple(self, first: int, second: int) -> None:
        """Gear two joints of this body so that they keep the same position."""
        gear = self.api.createConstraint(
            self.index, first, self.index, second, self.api.JOINT_GEAR, (0, 1, 0), (0, 0, 0), (0, 0, 0)
        )
        # erp: fraction of a difference corrected per substep; at .2 two fingers on an object differ by 2 mm, at 1 by .4
        self.api.changeConstraint(gear, gearRatio=-1, maxForce=1000.0, erp=1.0)

    def anchor_friction(self, link: int, *, on: bool) -> None:
        """Let static friction at this link hold positions, or only speeds.

        Without anchors a held object creeps by mm per s: friction stops its speed in each physics step, and the hand
        moves on along a circle. The friction cone stays the same.
        """
        self.api.changeDynamics(self.index, link, frictionAnchor=int(on))

    def inertia(self, link: int = -1) -> tuple[float, Vector]:
        """Mass in kg and the diagonal of the inertia in kg m2."""
        state = self.api.getDynamicsInfo(self.index, link)
        return state[0], state[2]

    def set_inertia(self, mass: float, diagonal: Vector, link: int = -1) -> None:
        # with the mass alone pybullet would guess the inertia from the shape
        self.api.changeDynamics(self.index, link, mass=mass, localInertiaDiagonal=diagonal)

    def set_air_drag(self, drag: float, link: int = -1) -> None:
        """Set PyBullet's damping of a link's velocity, per s. PyBullet's own default is .04."""
        self.api.changeDynamics(self.index, link, linearDamping=drag, angularDamping=drag)

    def joint_damping(self, link: int) -> float:
        """Viscous friction of the joint above the link, in N m s/rad."""
        damping: float = self.api.getJointInfo(self.index, link)[6]
        return damping

    def mass_matrix(self) -> Array:
        """The mass matrix (n, n) of the moving joints at position 0, in kg m2 or kg."""
        count = sum(
            self.api.getJointInfo(self.index, joint)[2] != self.api.JOINT_FIXED
            for joint in range(self.api.getNumJoints(self.index))
        )
        return np.array(self.api.calculateMassMatrix(self.index, [0.0] * count))

    def set_joint_damping(self, damping: float, link: int) -> None:
        """Set the viscous friction of the joint above the link, in N m s/rad."""
        self.api.changeDynamics(self.index, link, jointDamping=damping)
