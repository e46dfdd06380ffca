"""Vectors, quaternions and boxes. Units: m and rad; quaternions x y z w."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Box:
    """An axis-aligned box in m."""

    low: Vector
    high: Vector

    @property
    def centre(self) -> Vector:
        (a, b, c), (d, e, f) = self.low, self.high
        return (a + d) / 2, (b + e) / 2, (c + f) / 2

    @property
    def diagonal(self) -> float:
        """Length in m."""
        return float(sum((high - low) ** 2 for low, high in zip(self.low, self.high, strict=True)) ** 0.5)

    def contains(self, point: Sequence[float], margin: float = 0.0) -> bool:
        return all(
            low - margin <= value <= high + margin for low, value, high in zip(self.low, point, self.high, strict=True)
        )

    def moved(self, by: Vector) -> Box:
        """The box, moved by so many m along each axis."""
        (a, b, c), (d, e, f), (x, y, z) = self.low, self.high, by
        return Box((a + x, b + y, c + z), (d + x, e + y, f + z))

    def middle(self, edges: Vector) -> Box:
        """The box with these edge lengths around the same centre, cut to this box."""
        half = [min(edge, high - low) / 2 for edge, low, high in zip(edges, self.low, self.high, strict=True)]
        (x, y, z), (a, b, c) = self.centre, half
        return Box((x - a, y - b, z - c), (x + a, y + b, z + c))
