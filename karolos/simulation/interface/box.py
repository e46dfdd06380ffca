"""Boxes in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..body import Vector


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

    def middle(self, edges: Vector) -> Box:
        """The box of these edge lengths in the middle of this one, never larger than it."""
        half = [min(edge, high - low) / 2 for edge, low, high in zip(edges, self.low, self.high, strict=True)]
        (x, y, z), (a, b, c) = self.centre, half
        return Box((x - a, y - b, z - c), (x + a, y + b, z + c))
