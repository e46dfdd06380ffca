"""From changes of joint positions to ramps of joint speeds, within the limits of the joints."""

from __future__ import annotations

from collections.abc import Sequence

from ..simulation.interface import JointLimits

ACCELERATION_TIME = 1 / 24
"""Seconds in which a joint changes its speed by its largest speed, unless the robot has an acceleration."""
BRAKING_TIME = 1 / 12
"""Time constant, in s, with which a joint approaches the end of its range. A hard stop would push the other joints."""
REFERENCE_LAG = 0.01
"""Largest distance, in rad, of the reference from its joint. It bounds what an arm that is held back accumulates."""
SPEED_SHARE = 0.97
"""Fraction of a joint's largest speed at which it moves steadily. The rest is for the correction of its reference."""


class JointControl:
    """Turns changes of joint positions into ramps of joint speeds, one per control step.

    A change d per control step is a speed, d / T, that the joint reaches at the end of the step:

        w = d / T, limited by the largest speed, the acceleration and the range of the joint
        r = r + (w_before + w) / 2 T, the reference, at most `REFERENCE_LAG` away from the joint before it moves
        ramp from v to w + c, c = (r - x) / T - (v + w) / 2, within the acceleration and the largest speed

    x and v are the joint's position and speed, T is the period. The mean of a ramp times T is the distance that it
    moves the joint. The correction c removes half of the distance between joint and reference.
    A joint that follows its ramps moves by exactly d per step in steady motion, without loss at low speeds. A joint
    with d = 0 stays at its reference under any load that its torque can hold.

    Args:
        limits: of the joints.
        period: duration T of a control step in s.
        accelerations: largest acceleration of each joint in rad/s2; by default its speed limit / `ACCELERATION_TIME`.
    """

    def __init__(self, limits: JointLimits, period: float, accelerations: Sequence[float] | None = None) -> None:
        self._period = period
        self._references: Sequence[float] = ()
        self._speeds: Sequence[float] = ()
        accelerations = accelerations or [speed / ACCELERATION_TIME for speed in limits.velocity]
        # lower, upper, largest speed, largest change of speed per control step, time constant of braking
        self._bounds = tuple(
            (low, high, speed, acceleration * period, max(BRAKING_TIME, speed / acceleration))
            for low, high, speed, acceleration in zip(
                limits.lower, limits.upper, limits.velocity, accelerations, strict=True
            )
        )

    def reset(self, positions: Sequence[float]) -> None:
        """Start from these positions in rad, at rest."""
        self._references = positions
        self._speeds = (0.0,) * len(positions)

    def ramp(self, positions: Sequence[float], velocities: Sequence[float], changes: Sequence[float]) -> list[float]:
        """Speeds (n,) in rad/s at the end of a ramp that starts at `velocities` and changes the joints by `changes`."""
        period = self._period
        references, speeds, ends = [], [], []
        for position, velocity, change, before, last, (low, high, limit, rise, braking) in zip(
            positions, velocities, changes, self._references, self._speeds, self._bounds, strict=True
        ):
            speed, most = change / period, SPEED_SHARE * limit
            fastest, slowest = min(velocity + rise, most), max(velocity - rise, -most)
            if position + braking * fastest > high:
                fastest = (high - position) / braking
            if position + braking * slowest < low:
                slowest = (low - position) / braking
            speed = fastest if speed > fastest else slowest if speed < slowest else speed
            held = min(max(before, position - REFERENCE_LAG), position + REFERENCE_LAG)
            reference = held + (last + speed) / 2 * period
            references.append(reference)
            speeds.append(speed)
            end = speed + (reference - position) / period - (velocity + speed) / 2
            ends.append(min(max(end, velocity - rise, -limit), velocity + rise, limit))
        self._references, self._speeds = references, speeds
        return ends
