"""One body of a world: its pose, its joints, its material."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Colour = tuple[float, float, float, float]
"""Red, green, blue, opacity in [0, 1]."""
UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)


class LinkState(NamedTuple):
    """Frame of a link (m, quaternion), velocity of its centre of mass (m/s) and of its turning (rad/s), the centre."""

    position: Vector
    orientation: Quaternion
    velocity: Vector
    angular_velocity: Vector
    centre: Vector


class Body:
    """A handle. Joints are named by their index, as the URDF orders them; -1 is the base.

    Every getter and setter is one call into pybullet: 1 to 3 us each.
    """

    def __init__(self, api: Any, client: int, index: int) -> None:
        self.api = api
        self.client = client
        self.index = index

    def links(self) -> dict[str, int]:
        """Index of each link, which is that of the joint above it, by name; without the base."""
        count = self.api.getNumJoints(self.index, physicsClientId=self.client)
        found = [self.api.getJointInfo(self.index, joint, physicsClientId=self.client) for joint in range(count)]
        return {info[12].decode(): index for index, info in enumerate(found)}

    def collide_only(self, pairs: Collection[tuple[int, int]]) -> None:
        """Let these pairs of links touch each other, and no others of this body."""
        count = self.api.getNumJoints(self.index, physicsClientId=self.client)
        for first in range(-1, count):
            for second in range(first + 1, count):
                enabled = (first, second) in pairs or (second, first) in pairs
                self.api.setCollisionFilterPair(
                    self.index, self.index, first, second, enabled, physicsClientId=self.client
                )

    def place(self, position: Vector, orientation: Quaternion = UPRIGHT) -> None:
        """Put the base there, at rest."""
        self.api.resetBasePositionAndOrientation(self.index, position, orientation, physicsClientId=self.client)
        self.api.resetBaseVelocity(self.index, (0, 0, 0), (0, 0, 0), physicsClientId=self.client)

    def pose(self) -> tuple[Vector, Quaternion]:
        position, orientation = self.api.getBasePositionAndOrientation(self.index, physicsClientId=self.client)
        return position, orientation

    def velocity(self) -> tuple[Vector, Vector]:
        """Of the base: m/s and rad/s."""
        linear, angular = self.api.getBaseVelocity(self.index, physicsClientId=self.client)
        return linear, angular

    def link(self, link: int, *, moved: bool = False) -> LinkState:
        """State of a link. `moved`: joints were written since the last step, so compute the frames anew."""
        state = self.api.getLinkState(self.index, link, 1, moved, physicsClientId=self.client)
        return LinkState(state[4], state[5], state[6], state[7], state[0])

    def joints(self, joints: Sequence[int]) -> tuple[tuple[float, float, Any, float], ...]:
        """For each joint position, velocity, reaction forces and motor torque (rad or m, per s, -, N m or N)."""
        states: tuple[tuple[float, float, Any, float], ...] = self.api.getJointStates(
            self.index, joints, physicsClientId=self.client
        )
        return states

    def write_joints(
        self, joints: Sequence[int], positions: Sequence[float], velocities: Sequence[float] | None = None
    ) -> None:
        """Put joints there, at rest unless told otherwise, without a physics step."""
        self.api.resetJointStatesMultiDof(
            self.index,
            joints,
            [(position,) for position in positions],
            [(velocity,) for velocity in velocities] if velocities else [(0.0,)] * len(joints),
            physicsClientId=self.client,
        )

    def prepare_motor(self, joint: int, velocity: float) -> None:
        """Limit the speed that the joint's motor asks for (rad/s or m/s). The limit stays for later `drive` calls."""
        self.api.setJointMotorControl2(
            self.index,
            joint,
            self.api.POSITION_CONTROL,
            targetPosition=0.0,
            force=0.0,
            maxVelocity=velocity,
            physicsClientId=self.client,
        )

    def drive(
        self,
        joints: Sequence[int],
        positions: Sequence[float],
        forces: Sequence[float],
        gains: Sequence[float],
        dampings: Sequence[float] | None = None,
        velocities: Sequence[float] | None = None,
    ) -> None:
        """Aim the motors at positions until told otherwise.

        Args:
            forces: largest torque or force of each motor in N m or N, divided by the substeps of the world: pybullet
                turns it into an impulse with the time of the whole control step, not of a substep.
            gains: share of the distance to the target that a motor asks for per substep.
            dampings: share of its speed that a motor gives up per substep, in (0, 1]; 1 each unless told otherwise,
                which is a motor without inertia. A gain of damping**2 / 4 is critically damped.
            velocities: with which to pass the targets, rad/s or m/s; 0 unless told otherwise.
        """
        self.api.setJointMotorControlArray(
            self.index,
            joints,
            self.api.POSITION_CONTROL,
            targetPositions=positions,
            forces=forces,
            positionGains=gains,
            velocityGains=dampings or [1.0] * len(joints),
            targetVelocities=velocities or [0.0] * len(joints),
            physicsClientId=self.client,
        )

    def limit_joint_speed(self, velocity: float) -> None:
        """Cap the speed of every joint of this body in rad/s, whatever pushes it."""
        self.api.changeDynamics(self.index, -1, maxJointVelocity=velocity, physicsClientId=self.client)

    def set_friction(self, lateral: float, link: int = -1) -> None:
        self.api.changeDynamics(self.index, link, lateralFriction=lateral, physicsClientId=self.client)

    def couple(self, first: int, second: int) -> None:
        """Gear two joints of this body so that they keep the same position, as one motor moves both."""
        gear = self.api.createConstraint(
            self.index,
            first,
            self.index,
            second,
            self.api.JOINT_GEAR,
            (0, 1, 0),
            (0, 0, 0),
            (0, 0, 0),
            physicsClientId=self.client,
        )
        # erp: share of a difference taken back per substep; at .2 two fingers on an object differ by 2 mm, at 1 by .4
        self.api.changeConstraint(gear, gearRatio=-1, maxForce=1000.0, erp=1.0, physicsClientId=self.client)

    def stick(self, link: int) -> None:
        """Let static friction at this link hold positions, not only speeds.

        Within the friction cone, as ever; without it the solver's rounding lets a held object creep by mm per s.
        """
        self.api.changeDynamics(self.index, link, frictionAnchor=1, physicsClientId=self.client)

    def inertia(self, link: int = -1) -> tuple[float, Vector]:
        """Mass in kg and the diagonal of the inertia in kg m2."""
        state = self.api.getDynamicsInfo(self.index, link, physicsClientId=self.client)
        return state[0], state[2]

    def set_inertia(self, mass: float, diagonal: Vector, link: int = -1) -> None:
        """Both at once: with the mass alone pybullet would guess the inertia from the shape."""
        self.api.changeDynamics(self.index, link, mass=mass, localInertiaDiagonal=diagonal, physicsClientId=self.client)

    def set_air_drag(self, drag: float, link: int = -1) -> None:
        """PyBullet's damping of each link's velocity per s; .04 unless told otherwise."""
        self.api.changeDynamics(self.index, link, linearDamping=drag, angularDamping=drag, physicsClientId=self.client)

    def set_joint_damping(self, damping: float, link: int) -> None:
        """Viscous friction of the joint above the link, in N m s/rad."""
        self.api.changeDynamics(self.index, link, jointDamping=damping, physicsClientId=self.client)
