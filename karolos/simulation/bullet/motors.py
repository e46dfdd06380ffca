"""The motors of an arm and its gripper in PyBullet."""

from __future__ import annotations

from collections.abc import Sequence
from operator import gt

from ..interface.engine import Fingers, JointLimits
from .body import Body

DAMPING = 0.5
"""Fraction of its speed that a motor gives up per substep. At 1 a motor has no inertia: an arm would change its speed
at 500 rad/s2, which no arm does, which overruns joints and shakes a cube out of any friction grip."""
GAIN = DAMPING**2 / 4
"""Fraction of the distance to its target that a motor asks for per substep; critically damped: 71 % of a small step is
done in ten substeps."""
FINGER_GAIN = 0.1
BELOW_CAP = 0.97
"""Fraction of a joint's largest speed that its motor asks for. Speeds are capped after contacts are solved, and where a
cap binds a gripped object slips: creep of a cube in a 1 s shake 8 mm at 1, .4 mm at .97 (Panda)."""


class Motors:
    """Implements `interface.Motors`.

    Args:
        joints: of the arm, from base to wrist, as the body counts them.
        pads: joints of the two fingers; empty without a gripper.
    """

    def __init__(
        self,
        body: Body,
        substeps: int,
        limits: JointLimits,
        joints: Sequence[int],
        fingers: Fingers | None,
        pads: Sequence[int],
    ) -> None:
        self.pads = pads
        self._body = body
        self._substeps = substeps
        self._limits = limits
        self._size = len(joints)
        self._joints = list(joints)
        self._fingers = fingers
        # A motor that is short of torque can be overrun, when the arm hits the floor, itself or the end of a joint.
        # PyBullet caps all joints of a body at one speed, the fastest one's; `read` brakes the others.
        body.limit_joint_speed(max(limits.velocity))
        for link, speed in zip(joints, limits.velocity, strict=True):
            body.limit_motor_speed(link, BELOW_CAP * speed)
        for link in (-1, *joints):
            body.set_air_drag(0.0, link)
        if fingers is not None:
            self._joints.append(pads[0])  # one motor with the force of both: the gear moves the other finger
            for link in pads:
                body.limit_motor_speed(link, fingers.gripper.speed)
                body.set_air_drag(0.0, link)
                body.anchor_friction(link)
            body.couple(*pads)
            self.set_pad_friction(fingers.gripper.pad_friction)
        self._masses = [(link, *body.inertia(link)) for link in (*joints, *pads)]
        self.set_joint_friction(0.0)
        self.set_gain(1.0)

    def set_joint_friction(self, torque: float) -> None:
        forces = [effort - min(torque, effort / 2) for effort in self._limits.effort]
        if self._fingers is not None:
            forces.append(2 * self._fingers.gripper.force)
        self._forces = [force / self._substeps for force in forces]  # see Body.drive

    def set_joint_damping(self, damping: float) -> None:
        for link in self._joints[: self._size]:
            self._body.set_joint_damping(damping, link)

    def set_gain(self, factor: float) -> None:
        grippers = len(self._joints) - self._size
        self._gains = [GAIN * factor] * self._size + [FINGER_GAIN] * grippers
        self._dampings = [DAMPING * factor**0.5] * self._size + [1.0] * grippers  # critical for every factor

    def set_mass(self, factor: float) -> None:
        for link, mass, (x, y, z) in self._masses:
            self._body.set_inertia(mass * factor, (x * factor, y * factor, z * factor), link)

    def set_pad_friction(self, friction: float) -> None:
        for link in self.pads:
            self._body.set_friction(friction, link)

    def write(self, positions: Sequence[float], opening: float) -> None:
        if self._fingers is not None:
            finger = self._fingers.position(opening)
            positions = [*positions, finger]
            self._body.write_joints(self.pads[1:], [finger])
        self._body.write_joints(self._joints, positions)
        self._body.drive(self._joints, positions, self._forces, self._gains, self._dampings)

    def drive(self, positions: Sequence[float], velocities: Sequence[float], opening: float | None) -> None:
        if self._fingers is not None and opening is not None:
            positions, velocities = [*positions, self._fingers.position(opening)], [*velocities, 0.0]
        self._body.drive(self._joints, positions, self._forces, self._gains, self._dampings, velocities)

    def read(self) -> tuple[Sequence[float], Sequence[float], float]:
        positions, velocities, _, _ = zip(*self._body.joints(self._joints), strict=True)
        opening = 0.0
        if self._fingers is not None:
            opening = self._fingers.opening(positions[-1])
            positions, velocities = positions[:-1], velocities[:-1]
        if any(map(gt, map(abs, velocities), self._limits.velocity)):
            velocities = tuple(
                min(max(speed, -most), most) for speed, most in zip(velocities, self._limits.velocity, strict=True)
            )
            self._body.write_joints(self._joints[: self._size], positions, velocities)
        return positions, velocities, opening
