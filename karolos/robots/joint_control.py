"""From changes of joint positions to targets of the motors."""

from __future__ import annotations

from collections.abc import Sequence

from ..simulation.interface import JointLimits

ACCELERATION_TIME = 1 / 24
"""Seconds in which a motor's speed changes by its largest speed, at least: 52 rad/s2 for a Panda's shoulder (its data
sheet: 7.5 to 20). Without a bound a cube creeps .9 mm in a 1 s shake instead of .3; at 1/12 experts overshoot."""
BRAKING_TIME = 1 / 12
"""Seconds before the limit of a joint, at its speed, from which on a motor slows down: a hard stop flings others."""
TARGET_LAG = 0.01
"""Largest distance, in rad, between a motor's last target and its joint's position. Without a memory of the last target
an arm would sink under gravity; without a bound, an arm that is held back would accumulate a distance."""


class JointControl:
    """Position control of an arm's joints within their limits, in rad and rad/s.

    Args:
        period: duration of a control step in s.
    """

    def __init__(self, limits: JointLimits, period: float) -> None:
        self._period = period
        self._targets: Sequence[float] = ()
        # lower, upper, largest change of speed per control step, 1 / (largest speed * period^2)
        self._bounds = tuple(
            (low, high, speed * period / ACCELERATION_TIME, 1 / (speed * period**2))
            for low, high, speed in zip(limits.lower, limits.upper, limits.velocity, strict=True)
        )

    def reset(self, positions: Sequence[float]) -> None:
        """Start from these targets."""
        self._targets = positions

    def targets(
        self, positions: Sequence[float], velocities: Sequence[float], changes: Sequence[float]
    ) -> tuple[list[float], list[float]]:
        """Target positions and velocities (n,) that change the joints by `changes`.

        Motors pass their targets at speeds that grow with the square of the change: an arm that goes far does not slow
        down at every control step, one that is nearly there stops. All speeds have the same ratio to their changes, so
        that the tool keeps its direction; with a ratio for each joint it would leave the line by 2 cm a step. From its
        current speed a motor accelerates evenly, within `ACCELERATION_TIME`, and it brakes before a joint limit.
        """
        targets, speeds = [], []
        rate = min(
            1 / self._period,
            max(abs(change) * bounds[3] for change, bounds in zip(changes, self._bounds, strict=False)),
        )
        for position, velocity, change, last, (low, high, acceleration, _) in zip(
            positions, velocities, changes, self._targets, self._bounds, strict=True
        ):
            low_base, high_base = position - TARGET_LAG, position + TARGET_LAG
            base = low_base if last < low_base else high_base if last > high_base else last
            speed = rate * change
            fastest, slowest = velocity + acceleration, velocity - acceleration
            if position + BRAKING_TIME * fastest > high:
                fastest = (high - position) / BRAKING_TIME
            if position + BRAKING_TIME * slowest < low:
                slowest = (low - position) / BRAKING_TIME
            if slowest <= speed <= fastest:
                target = base + change
            else:
                speed = fastest if speed > fastest else slowest
                target = base + (velocity + speed) / 2 * self._period
            targets.append(low if target < low else high if target > high else target)
            speeds.append(speed)
        self._targets = targets
        return targets, speeds
