"""From changes of joint positions to ramps of joint speeds, within the limits of the joints and of the tool."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, inf, sqrt

from ..simulation.interface import JointLimits
from ..simulation.kinematics import Chain, Configuration

ACCELERATION_TIME = 1 / 24
"""Seconds in which a joint changes its speed by its largest speed, where no maker's acceleration counts."""
BRAKING_TIME = 1 / 12
"""Time constant, in s, with which a joint approaches the end of its range. A hard stop would push the other joints.
Further away its speed is one from which half of its acceleration stops it."""
REFERENCE_LAG = 0.01
"""Largest distance, in rad, of the reference from its joint. It bounds what an arm that is held back accumulates."""
SPEED_SHARE = 0.97
"""Fraction of a joint's largest speed at which it moves steadily. The rest is for the correction of its reference."""
TOOL_SPEED_SHARE = 0.98
"""Fraction of the tool's largest speed at the end of a control step. The rest is for what happens inside."""
SLOW_TOOL = 0.8
"""Fraction of that speed below which the tool's speed, with the present pose, needs no closer look."""
SCALINGS = 4
"""Largest number of times that a ramp is scaled down. Once does not suffice where accelerations limit the braking."""


class Ramps:
    """Turns changes of joint positions into ramps of joint speeds, one per control step.

    A change d per control step is a speed, d / T, that the joint reaches at the end of the step:

        w = v + k (d / T - v), with d / T limited by the largest speed of the joint, w by its range
        k <= 1, the largest share with which no joint exceeds its acceleration
        r = r + (w_before + w) / 2 T, the reference, at most `REFERENCE_LAG` away from the joint before it moves
        ramp from v to w + c, c = (r - x) / T - (v + w) / 2, within the acceleration and the largest speed

    x and v are the joint's position and speed, T is the period. The mean of a ramp times T is the distance that it
    moves the joint. The correction c removes half of the distance between joint and reference.
    All joints take the same share k of their changes of speed: limited one by one, their motion would leave its
    direction, and actions that alternate could move a tool to where nobody sends it.
    A joint that follows its ramps moves by exactly d per step in steady motion, without loss at low speeds. A joint
    with d = 0 stays at its reference under any load that its torque can hold.

    Where the tool would be too fast at the end of the step, by forward kinematics, all ramps' ends are scaled down
    alike, and the references are where that leads.

    Args:
        limits: of the joints.
        period: duration T of a control step in s.
        accelerations: largest acceleration of each joint in rad/s2.
        tool: kinematics of the arm, and the largest speed of its tool in m/s.
    """

    def __init__(
        self,
        limits: JointLimits,
        period: float,
        accelerations: Sequence[float],
        tool: tuple[Chain, float] | None = None,
    ) -> None:
        self._period = period
        self._tool = tool if tool is not None and tool[1] < inf else None
        self._references: Sequence[float] = ()
        self._speeds: Sequence[float] = ()
        # lower, upper, largest speed, largest acceleration, time at that speed in which it brakes
        self._bounds = tuple(
            (low, high, speed, acceleration, max(BRAKING_TIME, speed / acceleration))
            for low, high, speed, acceleration in zip(
                limits.lower, limits.upper, limits.velocity, accelerations, strict=True
            )
        )

    def reset(self, positions: Sequence[float]) -> None:
        """Start from these positions in rad, at rest."""
        self._references = positions
        self._speeds = (0.0,) * len(positions)

    def ramp(
        self,
        positions: Sequence[float],
        velocities: Sequence[float],
        changes: Sequence[float],
        pose: Configuration | None = None,
    ) -> list[float]:
        """Speeds (n,) in rad/s at the end of a ramp that starts at `velocities` and changes the joints by `changes`.

        `pose` is the chain at `positions`; without it the speed of the tool is not limited.
        """
        references, speeds, ends = self._ramp(positions, velocities, changes)
        if self._tool is not None and pose is not None:
            chain, largest = self._tool
            most = TOOL_SPEED_SHARE * largest
            if hypot(*chain.velocity(pose, ends)) > SLOW_TOOL * most:
                slowed = self._slowed(chain, most, positions, velocities, ends)
                if slowed is not ends:  # nothing is made up for later
                    references, speeds, ends = self._after(positions, velocities, slowed), slowed, slowed
        self._references, self._speeds = references, speeds
        return ends

    def _slowed(
        self, chain: Chain, most: float, positions: Sequence[float], velocities: Sequence[float], ends: list[float]
    ) -> list[float]:
        """Ends of the ramp, scaled down until the tool moves at `most` m/s after the step or all joints brake."""
        share, slowed = 1.0, ends
        for _ in range(SCALINGS):
            speed = hypot(*chain.velocity(chain.forward(self._after(positions, velocities, slowed)), slowed))
            if speed <= most:
                break
            share *= most / speed
            slowed = [
                min(max(share * end, velocity - bounds[3] * self._period), velocity + bounds[3] * self._period)
                for end, velocity, bounds in zip(ends, velocities, self._bounds, strict=True)
            ]
        return slowed

    def _after(self, positions: Sequence[float], velocities: Sequence[float], ends: Sequence[float]) -> list[float]:
        """Positions (n,) in rad after a ramp from `velocities` to `ends`."""
        half = self._period / 2
        return [at + half * (v + w) for at, v, w in zip(positions, velocities, ends, strict=True)]

    def _ramp(
        self, positions: Sequence[float], velocities: Sequence[float], changes: Sequence[float]
    ) -> tuple[list[float], list[float], list[float]]:
        """References in rad after the step, speeds w and ends of the ramp in rad/s, each (n,)."""
        period = self._period
        wanted, share = [], 1.0
        for change, velocity, (_, _, limit, acceleration, _) in zip(changes, velocities, self._bounds, strict=True):
            most = SPEED_SHARE * limit
            speed = min(max(change / period, -most), most)
            wanted.append(speed)
            if abs(speed - velocity) * share > acceleration * period:
                share = acceleration * period / abs(speed - velocity)
        references, speeds, ends = [], [], []
        for position, velocity, target, before, last, (low, high, limit, acceleration, braking) in zip(
            positions, velocities, wanted, self._references, self._speeds, self._bounds, strict=True
        ):
            speed, rise = velocity + share * (target - velocity), acceleration * period
            if position + braking * speed > high:
                speed = max(min(speed, _approach(high - position, acceleration)), velocity - rise)
            elif position + braking * speed < low:
                speed = min(max(speed, -_approach(position - low, acceleration)), velocity + rise)
            held = min(max(before, position - REFERENCE_LAG), position + REFERENCE_LAG)
            reference = held + (last + speed) / 2 * period
            references.append(reference)
            speeds.append(speed)
            end = speed + (reference - position) / period - (velocity + speed) / 2
            ends.append(min(max(end, velocity - rise, -limit), velocity + rise, limit))
        return references, speeds, ends


def _approach(room: float, acceleration: float) -> float:
    """Largest speed in rad/s of a joint towards the end of its range, which is `room` rad away."""
    speed = room / BRAKING_TIME
    return min(speed, sqrt(acceleration * room)) if room > 0 else speed
