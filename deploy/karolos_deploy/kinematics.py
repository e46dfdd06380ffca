"""Kinematics of a serial arm in numpy, from the numbers of a bundle. Units: m, rad; rotations are matrices (3, 3)."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def turned_by(vector: ArrayLike) -> Array:
    """The rotation by a rotation vector: its direction is the axis, its length the angle."""
    x, y, z = np.asarray(vector, float).tolist()
    angle = float(np.sqrt(x * x + y * y + z * z))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, rest = (np.sin(angle) / angle, (1 - np.cos(angle)) / angle**2) if angle > 1e-9 else (1.0, 0.5)
    rotation: Array = np.eye(3) + sine * cross + rest * cross @ cross
    return rotation


def turn_of(rotation: Array) -> Array:
    """The rotation vector, of at most pi rad, of a rotation."""
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    vector: Array = np.array([h - f, c - g, d - b]) / 2
    size, cosine = float(np.linalg.norm(vector)), (a + e + i - 1) / 2
    if size > 1e-6:
        vector *= np.arctan2(size, cosine) / size
    elif cosine < 0:  # half a turn: R = 2 u u^T - 1
        axis = np.sqrt(np.maximum(np.array([a, e, i]) + 1, 0) / 2)
        first = int(axis.argmax())
        vector = np.pi * (rotation[first] + np.eye(3)[first]) / (2 * axis[first])
    return vector


@dataclass(frozen=True)
class Configuration:
    """A chain at given joint positions."""

    position: Array
    """Position of the tool (3,)."""
    rotation: Array
    """Rotation of the tool; its columns are the axes of the tool's frame."""
    jacobian: Array
    """(6, n): velocity of the tool in m/s, then its angular velocity in rad/s, per rad/s of each joint."""


class Chain:
    """A serial chain of revolute joints from the world to a tool.

    Args:
        links: (n + 1, 12): for each joint and the tool, translation and rotation (row by row) in the frame before.
            Every joint turns about its z.
        base: position of the base in the world.
        damping: of damped least squares, in m/rad.
    """

    def __init__(self, links: ArrayLike, base: ArrayLike, damping: float) -> None:
        self._links: list[list[float]] = np.asarray(links, float).tolist()
        self.base, self.damping = np.asarray(base, float), damping
        self.size = len(self._links) - 1

    def at(self, positions: ArrayLike) -> Configuration:
        """The chain at joint positions (n,). In plain numbers: arrays of three take four times as long."""
        px, py, pz = self.base.tolist()
        a, b, c, d, e, f, g, h, i = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0  # rotation, row by row
        joints = []
        for (tx, ty, tz, *turned), angle in zip(
            self._links, [*np.asarray(positions, float).tolist(), 0.0], strict=True
        ):
            px, py, pz = px + a * tx + b * ty + c * tz, py + d * tx + e * ty + f * tz, pz + g * tx + h * ty + i * tz
            q, r, s, t, u, v, w, x, y = turned
            a, b, c = a * q + b * t + c * w, a * r + b * u + c * x, a * s + b * v + c * y
            d, e, f = d * q + e * t + f * w, d * r + e * u + f * x, d * s + e * v + f * y
            g, h, i = g * q + h * t + i * w, g * r + h * u + i * x, g * s + h * v + i * y
            joints.append((px, py, pz, c, f, i))
            sine, cosine = sin(angle), cos(angle)
            a, b = cosine * a + sine * b, cosine * b - sine * a
            d, e = cosine * d + sine * e, cosine * e - sine * d
            g, h = cosine * g + sine * h, cosine * h - sine * g
        columns = []
        for ox, oy, oz, u, v, w in joints[:-1]:  # axis times lever, then the axis
            x, y, z = px - ox, py - oy, pz - oz
            columns.append((v * z - w * y, w * x - u * z, u * y - v * x, u, v, w))
        rotation = np.array([[a, b, c], [d, e, f], [g, h, i]])
        return Configuration(np.array([px, py, pz]), rotation, np.array(columns).T)

    def step(self, at: Configuration, position: Array, rotation: Array, posture: Array) -> Array:
        """Change of the joints (n,) that moves the tool towards a pose: one step of damped least squares.

        `posture` (n,) is the preferred change. It is projected into the null space of the tool's motion.
        """
        (_, b, c), (d, _, f), (g, h, _) = (rotation @ at.rotation.T).tolist()
        error = np.array([*(position - at.position).tolist(), (h - f) / 2, (c - g) / 2, (d - b) / 2])
        jacobian = at.jacobian
        square = jacobian @ jacobian.T + self.damping**2 * np.eye(6)
        change: Array = posture + jacobian.T @ np.linalg.solve(square, error - jacobian @ posture)
        return change


class Orientations:
    """Orientations around one: turned about the vertical by at most `turn` rad, then tilted by at most `tilt` rad."""

    def __init__(self, middle: ArrayLike, tilt: float, turn: float) -> None:
        self.middle, self.tilt, self.turn = np.asarray(middle, float), tilt, turn

    def nearest(self, rotation: Array) -> Array:
        """The orientation itself, or turned and tilted no further than allowed."""
        away = rotation @ self.middle.T
        vector = turn_of(away)
        angle = float(np.linalg.norm(vector))
        upright = 2 * np.arctan2(np.sin(angle / 2) * vector[2] / max(angle, 1e-12), np.cos(angle / 2))
        tilts = turn_of(away @ turned_by((0.0, 0.0, -upright)))
        tilt = float(np.hypot(tilts[0], tilts[1]))
        if tilt <= self.tilt and abs(upright) <= self.turn:
            return rotation
        tilts = tilts * min(1.0, self.tilt / max(tilt, 1e-12))
        about = turned_by((0.0, 0.0, float(np.clip(upright, -self.turn, self.turn))))
        found: Array = turned_by((tilts[0], tilts[1], 0.0)) @ about @ self.middle
        return found


def chain_of(contract: dict[str, Any]) -> Chain:
    """The chain that a bundle's contract describes."""
    told = contract["kinematics"]
    return Chain(told["links"], told["base"], told["damping"])
