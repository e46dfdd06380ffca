"""Free flight of a cube: when and where it comes down."""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

import numpy as np

from ..core import Array
from ..simulation.geometry import Vector

LONGEST_FLIGHT = 3.0
"""Seconds that a flight is followed at the most; no robot throws higher than for 2."""
FLIGHT_STEPS = 100
"""Steps in which the floor is looked for along a whole flight."""


def flight_time(height: Array | float, rise: Array | float, gravity: float) -> Array:
    """Seconds (...) until free fall from `height` (...) m at `rise` (...) m/s upwards comes to height 0.

    The larger root of height + rise t + gravity t^2 / 2 = 0, gravity in m/s2 along z; at most `LONGEST_FLIGHT`, and 0
    for a height below 0.
    """
    gravity = min(gravity, -1e-6)  # without gravity only what sinks comes down
    above = np.maximum(height, 0.0)
    seconds = (rise + np.sqrt(rise * rise - 2 * gravity * above)) / -gravity
    return np.where(above > 0, np.minimum(seconds, LONGEST_FLIGHT), 0.0)


class Flight(NamedTuple):
    """A cube in free flight."""

    position: Vector
    velocity: Vector
    axes: tuple[Vector, Vector, Vector]
    """Unit vectors along its edges."""
    angular_velocity: Vector
    """rad/s. It is constant: a cube's inertia is the same about every axis."""
    half: float
    """Half an edge in m."""
    gravity: float
    """m/s2 along z; negative pulls down."""

    def lowest(self, seconds: float) -> float:
        """Height of the lowest corner above the floor after that time, in m."""
        x, y, z = self.angular_velocity
        rate = (x * x + y * y + z * z) ** 0.5
        upright = 0.0
        if rate < 1e-9:
            upright = sum(abs(axis[2]) for axis in self.axes)
        else:
            x, y, z = x / rate, y / rate, z / rate
            k, s = cos(rate * seconds), sin(rate * seconds)
            for a, b, c in self.axes:  # height of a rotated axis (Rodrigues)
                upright += abs(c * k + (x * b - y * a) * s + z * (x * a + y * b + z * c) * (1 - k))
        height = self.position[2] + self.velocity[2] * seconds + 0.5 * self.gravity * seconds * seconds
        return height - self.half * upright

    def landing(self, within: float, *, steps: int = 10) -> tuple[float, float] | None:
        """Position of the centre (x, y) in m when a corner first touches the floor, or None if not `within` seconds.

        The time is exact to 1 % of `within / steps` seconds.
        """
        before = 0.0
        for step in range(1, steps + 1):
            after = within * step / steps
            if self.lowest(after) <= 0:
                break
            before = after
        else:
            return None
        for _ in range(7):
            middle = (before + after) / 2
            before, after = (before, middle) if self.lowest(middle) <= 0 else (middle, after)
        return self.position[0] + self.velocity[0] * after, self.position[1] + self.velocity[1] * after
