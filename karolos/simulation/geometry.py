"""Vectors, quaternions and boxes. Units: m and rad; quaternions x y z w."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core import Array

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)


def matrix_of(quaternion: Quaternion) -> Array:
    """The rotation matrix (3, 3) of a quaternion, which need not have the length 1."""
    x, y, z, w = np.divide(quaternion, np.linalg.norm(quaternion)).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of(matrix: Array) -> Quaternion:
    """The quaternion of a rotation matrix (3, 3); w is not negative."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    products = np.array(  # 4 q q^T: its longest row is a multiple of q without loss of digits
        [
            [1 + a - e - i, b + d, c + g, h - f],
            [b + d, 1 - a + e - i, f + h, c - g],
            [c + g, f + h, 1 - a - e + i, d - b],
            [h - f, c - g, d - b, 1 + a + e + i],
        ]
    )
    row = products[np.argmax(np.diag(products))]
    x, y, z, w = (row / np.linalg.norm(row) * (1.0 if row[3] >= 0 else -1.0)).tolist()
    return x, y, z, w


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
