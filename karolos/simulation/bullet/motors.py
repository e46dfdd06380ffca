"""The motors of an arm and its gripper in PyBullet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..interface.engine import FINGER_GAIN, OPENS, Fingers, JointLimits
from .body import Body

STABLE_DAMPING = 0.5
"""Largest fraction of a joint's speed that its own damping removes per physics step. PyBullet integrates it explicitly:
from 1 on a light wrist oscillates."""


class Motors:
    """Implements `interface.Motors`. A motor is a constraint on the speed of its joint, limited in torque.

    Args:
        substeps: physics steps per control step.
        joints: of the arm, from base to wrist, as the body counts them.
        pads: joints of the two fingers; empty without a gripper.
        timestep: of a physics step in s.
    """

    def __init__(
        self,
        body: Body,
        substeps: int,
        limits: JointLimits,
        joints: Sequence[int],
        fingers: Fingers | None,
        pads: Sequence[int],
        *,
        timestep: float,
    ) -> None:
        self.pads = pads
        self._body = body
        self._fractions = [(step + 1) / substeps for step in range(substeps)]
        self._limits = limits
        self._size = len(joints)
        self._arm = list(joints)
        self._joints = [*joints, *pads[:1]]
        self._fingers = fingers
        for link in (-1, *joints):
            body.set_air_drag(0.0, link)
        if fingers is not None:
            for link in pads:
                body.limit_motor_speed(link, fingers.gripper.speed)
                body.set_air_drag(0.0, link)
                body.anchor_friction(link, on=True)
            self._opening, self._opens, self._releases_in_motion = 0.0, False, False
            self._command, self._moves_at = 0.0, 0
            body.couple(*pads)
            self.set_pad_friction(fingers.gripper.pad_friction)
        self._masses = [(link, *body.inertia(link)) for link in (*joints, *pads)]
        self._dampings = [body.joint_damping(link) for link in joints]
        if any(self._dampings):
            inertias = 1 / np.diagonal(np.linalg.inv(body.mass_matrix()))[: len(joints)]
            self._dampings = np.minimum(self._dampings, STABLE_DAMPING * inertias / timestep).tolist()
            self.set_joint_damping(0.0)
        self._begin: Sequence[float] = (0.0,) * len(joints)
        self._end: Sequence[float] = self._begin
        self.set_joint_friction(0.0)
        self.set_gain(1.0)

    def set_joint_friction(self, fraction: float) -> None:
        self._torques = [(1 - fraction) * effort for effort in self._limits.effort]

    def set_joint_damping(self, damping: float) -> None:
        for link, own in zip(self._arm, self._dampings, strict=True):
            self._body.set_joint_damping(own + damping, link)

    def set_gain(self, factor: float) -> None:
        self._gains = [factor] * self._size

    def set_mass(self, factor: float) -> None:
        for link, mass, (x, y, z) in self._masses:
            self._body.set_inertia(mass * factor, (x * factor, y * factor, z * factor), link)

    def set_pad_friction(self, friction: float) -> None:
        for link in self.pads:
            self._body.set_friction(friction, link)

    def release_in_motion(self) -> None:
        """From now on friction lets go while the gripper opens, see `World.release_in_motion`."""
        self._releases_in_motion = True

    def write(self, positions: Sequence[float], opening: float) -> None:
        self._begin = self._end = (0.0,) * self._size
        self._body.write_joints(self._arm, positions)
        if self._fingers is not None:
            finger = self._fingers.position(opening)
            self._body.write_joints(self.pads, [finger, finger])
            self._opening, self._moves_at = opening, 0
            self._anchor_unless(opens=False)
            self._drive_fingers(finger)

    def _drive_fingers(self, position: float) -> None:
        """One motor with the force of both fingers; the gear moves the other finger."""
        if self._fingers is not None:
            self._body.drive_position(self.pads[0], position, 2 * self._fingers.gripper.force, FINGER_GAIN)

    def _anchor_unless(self, *, opens: bool) -> None:
        if self._releases_in_motion and opens != self._opens:
            self._opens = opens
            for link in self.pads:
                self._body.anchor_friction(link, on=not opens)

    def drive(self, begin: Sequence[float], end: Sequence[float], opening: float | None, wait: float = 0.0) -> None:
        self._begin, self._end = begin, end
        if self._fingers is not None and opening is not None:
            self._command, self._moves_at = opening, int(wait * len(self._fractions))
            if not self._moves_at:
                self._move_fingers(opening)

    def _move_fingers(self, opening: float) -> None:
        if self._fingers is not None:
            self._anchor_unless(opens=opening > self._opening + OPENS)
            self._drive_fingers(self._fingers.position(opening))

    def substep(self, step: int) -> None:
        """Set the target speeds of physics step number `step` of the control step: those at its end."""
        if self._fingers is not None and 0 < self._moves_at == step:
            self._move_fingers(self._command)
        fraction = self._fractions[step]
        speeds = [first + fraction * (last - first) for first, last in zip(self._begin, self._end, strict=True)]
        self._body.drive_speeds(self._arm, speeds, self._torques, self._gains)

    def read(self) -> tuple[Sequence[float], Sequence[float], float]:
        positions, velocities, _, _ = zip(*self._body.joints(self._joints), strict=True)
        opening = 0.0
        if self._fingers is not None:
            self._opening = opening = self._fingers.opening(positions[-1])
            positions, velocities = positions[:-1], velocities[:-1]
        slowed = self._limits.slowed(velocities)
        if slowed is not None:
            self._body.write_joints(self._arm, positions, slowed)
        return positions, slowed or velocities, opening
