"""Where a cube in free flight comes down."""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

from ..simulation.body import Vector


class Flight(NamedTuple):
    """A cube that nothing touches: what its way and its turning follow from."""

    position: Vector
    velocity: Vector
    axes: tuple[Vector, Vector, Vector]
    """Unit vectors along its edges."""
    spin: Vector
    """Angular velocity in rad/s. It stays: a cube's inertia is the same about every axis."""
    half: float
    """Half an edge in m."""
    gravity: float
    """m/s2 along z; negative pulls down."""

    def lowest(self, seconds: float) -> float:
        """Height of the lowest corner above the floor after so long, in m."""
        x, y, z = self.spin
        rate = (x * x + y * y + z * z) ** 0.5
        upright = 0.0
        if rate < 1e-9:
            upright = sum(abs(axis[2]) for axis in self.axes)
        else:
            x, y, z = x / rate, y / rate, z / rate
            k, s = cos(rate * seconds), sin(rate * seconds)
            for a, b, c in self.axes:  # the height of an axis that turns (Rodrigues)
                upright += abs(c * k + (x * b - y * a) * s + z * (x * a + y * b + z * c) * (1 - k))
        height = self.position[2] + self.velocity[2] * seconds + 0.5 * self.gravity * seconds * seconds
        return height - self.half * upright

    def landing(self, within: float, *, steps: int = 10) -> tuple[float, float] | None:
        """Where its centre is along the floor when a corner first touches it; None: not within so many seconds.

        To within 1 % of a step, which is `within / steps` seconds.
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
