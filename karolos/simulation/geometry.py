"""Vectors, rotations and boxes. Units: m and rad; quaternions x y z w.

Compiled code calls these functions of rotations, too (see `control_kernel`), so they only use what numba compiles.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import atan2, copysign, cos, hypot, pi, sin, sqrt

import numpy as np

from ..core import Array, FloatArray

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
Colour = tuple[float, float, float, float]
"""Red, green, blue, opacity in [0, 1]."""


def vector(values: Iterable[str | float]) -> Vector:
    """The vector of three numbers or texts."""
    x, y, z = map(float, values)
    return x, y, z


def matrix_of(quaternion: Quaternion) -> Array:
    """The rotation matrix (3, 3) of a quaternion, which need not have the length 1."""
    x, y, z, w = np.divide(quaternion, np.linalg.norm(quaternion)).tolist()
    return np.column_stack(axes((x, y, z, w)))


def quaternion_of(matrix: Array) -> Quaternion:
    """The quaternion of a rotation matrix (3, 3); w is not negative."""
    return from_axes(*matrix.T.tolist())


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
        """The box, moved by a vector in m."""
        (a, b, c), (d, e, f), (x, y, z) = self.low, self.high, by
        return Box((a + x, b + y, c + z), (d + x, e + y, f + z))

    def middle(self, edges: Vector) -> Box:
        """The box with these edge lengths around the same centre, cut to this box."""
        half = [min(edge, high - low) / 2 for edge, low, high in zip(edges, self.low, self.high, strict=True)]
        (x, y, z), (a, b, c) = self.centre, half
        return Box((x - a, y - b, z - c), (x + a, y + b, z + c))


@dataclass(frozen=True)
class Orientations:
    """Orientations around one: turned about the vertical by at most `turn` rad, then tilted by at most `tilt` rad."""

    middle: Quaternion
    tilt: float
    turn: float

    def at(self, tilt_x: float, tilt_y: float, turn: float) -> Quaternion:
        """The orientation turned by `turn` rad, then tilted by the rotation vector (tilt_x, tilt_y, 0) in rad."""
        return tilted(self.middle, tilt_x, tilt_y, turn)


def tilted(middle: Quaternion, tilt_x: float, tilt_y: float, turn: float) -> Quaternion:
    """`middle`, turned about the vertical by `turn` rad, then tilted by the rotation vector (tilt_x, tilt_y, 0)."""
    return multiply(rotation_about((tilt_x, tilt_y, 0.0)), multiply(rotation_about((0.0, 0.0, turn)), middle))


def tilt_and_turn(middle: Quaternion, orientation: Quaternion) -> Vector:
    """tilt_x, tilt_y and turn in rad with which `tilted` gives this orientation."""
    x, y, z, w = multiply(orientation, inverse(middle))
    turn = 2 * atan2(z, w)
    turn -= 2 * pi * round(turn / (2 * pi))
    tilt_x, tilt_y, _ = rotation_vector(multiply((x, y, z, w), rotation_about((0.0, 0.0, -turn))))
    return tilt_x, tilt_y, turn


def nearest(middle: Quaternion, most_tilt: float, most_turn: float, orientation: Quaternion) -> Quaternion:
    """The orientation itself, or turned and tilted no further than allowed, in rad; see `Orientations`."""
    tilt_x, tilt_y, turn = tilt_and_turn(middle, orientation)
    tilt = hypot(tilt_x, tilt_y)
    if tilt <= most_tilt and abs(turn) <= most_turn:
        return orientation
    share = min(1.0, most_tilt / max(tilt, 1e-12))
    return tilted(middle, share * tilt_x, share * tilt_y, min(max(turn, -most_turn), most_turn))


def multiply(first: Quaternion, second: Quaternion) -> Quaternion:
    """The rotation `second`, then `first`."""
    (a, b, c, d), (x, y, z, w) = first, second
    return (
        d * x + a * w + b * z - c * y,
        d * y - a * z + b * w + c * x,
        d * z + a * y - b * x + c * w,
        d * w - a * x - b * y - c * z,
    )


def inverse(rotation: Quaternion) -> Quaternion:
    x, y, z, w = rotation
    return -x, -y, -z, w


def rotation_about(vector: Sequence[float]) -> Quaternion:
    """The rotation by a rotation vector: its direction is the axis, its length the angle in rad."""
    x, y, z = vector
    angle = sqrt(x * x + y * y + z * z)
    share = sin(angle / 2) / angle if angle > 0 else 0.5
    return share * x, share * y, share * z, cos(angle / 2)


def rotation_vector(rotation: Quaternion) -> Vector:
    """The rotation vector, of at most pi rad, of a rotation."""
    x, y, z, w = rotation
    size = sqrt(x * x + y * y + z * z)
    share = 2 * atan2(size, abs(w)) / size if size > 0 else 2.0
    share = -share if w < 0 else share
    return share * x, share * y, share * z


def rotated(rotation: Quaternion, vector: Sequence[float]) -> Vector:
    """The vector, turned."""
    (x, y, z, w), (a, b, c) = rotation, vector
    i, j, k = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return a + w * i + y * k - z * j, b + w * j + z * i - x * k, c + w * k + x * j - y * i


def axes(rotation: Quaternion) -> tuple[Vector, Vector, Vector]:
    """The columns of the rotation matrix: the world's axes, turned."""
    a, b, c, d, e, f = columns(rotation)
    return (a, b, c), (d, e, f), (b * f - c * e, c * d - a * f, a * e - b * d)


def columns(rotation: Quaternion) -> tuple[float, float, float, float, float, float]:
    """The first two columns of the rotation matrix.

    Unlike quaternions and angles they change continuously (Zhou et al. 2019, On the Continuity of Rotation
    Representations).
    """
    x, y, z, w = rotation
    return (
        1 - 2 * (y * y + z * z),
        2 * (x * y + w * z),
        2 * (x * z - w * y),
        2 * (x * y - w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z + w * x),
    )


def from_axes(x: Vector, y: Vector, z: Vector) -> Quaternion:
    """The rotation that turns the world's axes into these unit vectors; w is not negative."""
    (a, d, g), (b, e, h), (c, f, i) = x, y, z  # the rows of the matrix are a b c, d e f, g h i
    # the four components, each multiplied by the largest one: Shepperd 1978, Quaternion from Rotation Matrix
    p, q, r, s = 1 + a - e - i, 1 - a + e - i, 1 - a - e + i, 1 + a + e + i
    largest = max(p, q, r, s)
    if p == largest:
        q, r, s = b + d, c + g, h - f
    elif q == largest:
        p, r, s = b + d, f + h, c - g
    elif r == largest:
        p, q, s = c + g, f + h, d - b
    else:
        p, q, r = h - f, c - g, d - b
    size = copysign(sqrt(p * p + q * q + r * r + s * s), s)
    return p / size, q / size, r / size, s / size


def angles(first: Array, second: Array) -> FloatArray:
    """Angle in rad of the rotation between two, each given as two columns (..., 6): (...)."""
    a, b, c, d = first[..., :3], first[..., 3:], second[..., :3], second[..., 3:]
    same = np.vecdot(a, c), np.vecdot(b, d)
    # trace of the product; the third columns are cross products (Lagrange's identity)
    trace = same[0] + same[1] + same[0] * same[1] - np.vecdot(a, d) * np.vecdot(b, c)
    found: FloatArray = np.arccos(np.clip((trace - 1) / 2, -1, 1), dtype=np.float32)
    return found
