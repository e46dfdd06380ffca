"""The motors of an arm and its gripper in PyBullet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from math import exp

import numpy as np

from ...core import Array
from ..engines import BULLET
from ..geometry import Quaternion, Vector, matrix_of
from ..interface import FINGER_RATE, OPENS, PHYSICS_RATE, Body, Fingers, Frame, JointLimits, Loads, Spring
from ..kinematics import Numbers
from .body import BulletBody

STABLE_DAMPING = 0.5
"""Largest fraction of a joint's speed that its own damping removes per physics step. PyBullet integrates it explicitly:
a light wrist oscillates from 1 upwards."""


class BulletMotors:
    """Implements `interface.Motors`. A motor is a constraint on the speed of its joint, limited in torque.

    Args:
        joints: of the arm, from base to wrist, as the body counts them.
        pads: joints of the two fingers; empty without a gripper.
        tool: frame of the tool in the last link; None for an arm without.
    """

    def __init__(
        self,
        body: BulletBody,
        substeps: int,
        limits: JointLimits,
        joints: Sequence[int],
        fingers: Fingers | None,
        pads: Sequence[int],
        *,
        timestep: float,
        tool: Frame | None = None,
    ) -> None:
        self.pads = pads
        self._timestep = timestep
        self._tool = tool
        self.feels = False
        """Whether the wrench is measured in every physics step."""
        self._wrench, self._share, self._peak = np.zeros(6), 1.0, 0.0
        self._body, self.index = body, body.index
        self._api = api = body.api
        self._fractions = [(step + 1) / substeps for step in range(substeps)]
        self._limits = limits
        self._arm = list(joints)
        self._joints = [*joints, *pads[:1]]
        self._fingers = fingers
        self._drive_arm = partial(api.setJointMotorControlArray, body.index, self._arm, api.VELOCITY_CONTROL)
        for link in (-1, *joints):
            body.let_drift(link)
        if fingers is not None:
            # one motor with the force of both fingers; the gear moves the other finger
            self._drive_finger = partial(
                api.setJointMotorControl2,
                body.index,
                pads[0],
                api.POSITION_CONTROL,
                force=2 * fingers.gripper.force,
                positionGain=FINGER_RATE * timestep,
                velocityGain=1.0,
            )
            for link in pads:
                api.setJointMotorControl2(  # later calls keep the largest speed
                    body.index, link, api.POSITION_CONTROL, force=0.0, maxVelocity=fingers.gripper.speed
                )
                body.let_drift(link)
                body.change(link, frictionAnchor=1)
            self._opening, self._opens, self._releases_in_motion = 0.0, False, False
            origin = (0, 0, 0)
            gear = api.createConstraint(
                body.index, pads[0], body.index, pads[1], api.JOINT_GEAR, (0, 1, 0), origin, origin
            )
            # erp: fraction of a difference corrected per substep; fingers on an object differ by 2 mm at .2, by .4 at 1
            api.changeConstraint(gear, gearRatio=-1, maxForce=1000.0, erp=1.0)
            self.set_pad_friction(fingers.gripper.pad_friction)
        dynamics = {link: api.getDynamicsInfo(body.index, link) for link in (*joints, *pads)}
        self._masses = {link: (state[0], state[2]) for link, state in dynamics.items()}
        infos = [api.getJointInfo(body.index, joint) for joint in range(api.getNumJoints(body.index))]
        self._dampings = [infos[joint][6] for joint in joints]
        if any(self._dampings):
            moving = sum(info[2] != api.JOINT_FIXED for info in infos)
            masses = np.array(api.calculateMassMatrix(body.index, [0.0] * moving))
            inertias = 1 / np.diagonal(np.linalg.inv(masses))[: len(joints)]
            self._dampings = np.minimum(self._dampings, STABLE_DAMPING * inertias / timestep).tolist()
            self.set_joint_damping(0.0)
        self._openings: Mapping[int, float] = {}
        self._begin: Sequence[float] = (0.0,) * len(joints)
        self._period = substeps * timestep
        self._speeds: Sequence[float] = ()
        self._loads = [[0.0] * len(joints)] * 3
        self.largest: dict[tuple[int, int], float] = {}
        """As `World.largest_forces`."""
        self._end: Sequence[float] = self._begin
        self.set_joint_friction(0.0)
        self.set_gain(1.0)

    def set_joint_friction(self, fraction: float) -> None:
        self._torques = [(1 - fraction) * effort for effort in self._limits.effort]

    def set_joint_damping(self, damping: float) -> None:
        for link, own in zip(self._arm, self._dampings, strict=True):
            self._body.change(link, jointDamping=own + damping)

    def set_gain(self, factor: float) -> None:
        self._gains = [1 - (1 - factor) ** (PHYSICS_RATE * self._timestep)] * len(self._arm)

    def set_mass(self, factor: float) -> None:
        for link, (mass, (x, y, z)) in self._masses.items():
            self._body.set_inertia(mass * factor, (x * factor, y * factor, z * factor), link)

    def holds(self, body: Body | None = None) -> bool:  # noqa: ARG002
        return False  # there is no suction

    def set_pad_friction(self, friction: float) -> None:
        for link in self.pads:
            self._body.set_friction(friction, link)

    def release_in_motion(self) -> None:
        """From now on the opening gripper releases static friction, see `World.release_in_motion`."""
        self._releases_in_motion = True

    def write(self, positions: Numbers, opening: float) -> None:
        self._begin = self._end = (0.0,) * len(self._arm)
        self._write(self._arm, positions, self._begin)
        self._speeds, self._loads, self.largest = (), [[0.0] * len(self._arm)] * 3, {}
        self._wrench[:] = self._peak = 0.0
        if self._fingers is not None:
            finger = self._fingers.position(opening)
            self._write(self.pads, [finger, finger], [0.0, 0.0])
            self._opening, self._openings = opening, {}
            self._anchor_unless(opens=False)
            self._drive_finger(targetPosition=finger)

    def _write(self, joints: Sequence[int], positions: Numbers, velocities: Sequence[float]) -> None:
        """Set joint states without a physics step."""
        states = [[(value,) for value in values] for values in (positions, velocities)]
        self._api.resetJointStatesMultiDof(self._body.index, joints, *states)

    def _anchor_unless(self, *, opens: bool) -> None:
        """Let static friction at the pads hold positions, or only speeds while the gripper opens.

        Without anchors a held object creeps by mm per s: friction stops its speed in each physics step, and the hand
        moves on along a circle. The friction cone stays the same.
        """
        if self._releases_in_motion and opens != self._opens:
            self._opens = opens
            for link in self.pads:
                self._body.change(link, frictionAnchor=int(not opens))

    def drive(self, ramp: Array, openings: Mapping[int, float]) -> None:
        (self._begin, self._end), self._openings = ramp.tolist(), openings

    def substep(self, step: int) -> None:
        """Set the target speeds of physics step number `step` of the control step: those at its end."""
        if self._fingers is not None and step in self._openings:
            opening = self._openings[step]
            self._anchor_unless(opens=opening > self._opening + OPENS)
            self._drive_finger(targetPosition=self._fingers.position(opening))
        fraction = self._fractions[step]
        speeds = [first + fraction * (last - first) for first, last in zip(self._begin, self._end, strict=True)]
        self._drive_arm(targetVelocities=speeds, forces=self._torques, velocityGains=self._gains)

    def record(self, forces: Mapping[tuple[int, int], float]) -> None:
        """Raise the largest forces to those of a control step; `read` raises the loads."""
        for key, force in forces.items():
            self.largest[key] = max(self.largest.get(key, 0.0), force)
        if not self.feels:
            self.feel(1.0)

    def loads(self) -> Loads:
        speed, acceleration, torque = self._loads
        return Loads(speed, acceleration, torque, self._peak)

    def attach(self, spring: Spring) -> None:  # noqa: ARG002
        raise BULLET.lacks("impedance")

    def aim(self, position: Vector, orientation: Quaternion, velocity: Vector, spin: Vector) -> None:
        """Does nothing: there is no spring."""

    def wrench(self) -> Sequence[float]:
        self.feels = True
        return self._wrench.tolist()

    def set_wrench_filter(self, seconds: float) -> None:
        self._share = 1 - exp(-self._timestep / seconds) if seconds else 1.0

    def feel(self, share: float | None = None) -> None:
        """Update the low-passed wrench by the contacts of the hand in the last physics step."""
        if self._tool is None:
            return
        share = self._share if share is None else share
        hand, now = {self._arm[-1], *self.pads}, np.zeros(6)
        _, _, _, _, place, turn, *_ = self._api.getLinkState(self._body.index, self._arm[-1], 0, 1)
        place, turn = self._api.multiplyTransforms(place, turn, *self._tool)
        for _, _, other, link, opposite, at, _, normal, _, force, *friction in self._api.getContactPoints(self.index):
            if link in hand and not (other == self.index and opposite in hand):
                total = force * np.array(normal)
                for size, direction in zip(friction[::2], friction[1::2], strict=True):
                    total += size * np.array(direction)
                now += (*total, *np.cross(np.subtract(at, place), total))
        own = matrix_of(turn).T
        self._wrench += share * (np.concatenate((own @ now[:3], own @ now[3:])) - self._wrench)
        self._peak = max(self._peak, float(np.linalg.norm(self._wrench[:3])))

    def read(self) -> tuple[Array, Array, float]:
        positions, velocities, _, torques = zip(*self._body.joints(self._joints), strict=True)
        before, self._speeds = self._speeds, velocities[: len(self._arm)]
        if before:  # the first time after `write` the arm is at rest, with torques of the episode before
            rises = [(now - then) / self._period for now, then in zip(self._speeds, before, strict=True)]
            pairs = zip(self._loads, (self._speeds, rises, torques), strict=True)
            self._loads = [[max(most, abs(now)) for most, now in zip(*pair, strict=False)] for pair in pairs]
        opening = 0.0
        if self._fingers is not None:
            self._opening = opening = self._fingers.opening(positions[-1])
            positions, velocities = positions[:-1], velocities[:-1]
        return np.array(positions), np.array(velocities), opening
