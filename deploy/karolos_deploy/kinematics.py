"""Kinematics of a serial arm in numpy, from the numbers of a bundle. Units: m, rad; rotations are matrices (3, 3)."""

from __future__ import annotations

from dataclasses import dataclass
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
    """Of the tool (3,)."""
    rotation: Array
    """Of the tool; its columns are the axes of the tool's frame."""
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
        table = np.asarray(links, float)
        self.base, self.damping = np.asarray(base, float), damping
        self._origins, self._rotations = table[:, :3], table[:, 3:].reshape(-1, 3, 3)
        self.size = len(table) - 1

    def at(self, positions: ArrayLike) -> Configuration:
        """The chain at joint positions (n,)."""
        place, rotation = self.base, np.eye(3)
        origins, axes = np.empty((self.size, 3)), np.empty((self.size, 3))
        for joint, angle in enumerate(np.asarray(positions, float).tolist()):
            place = place + rotation @ self._origins[joint]
            rotation = rotation @ self._rotations[joint]
            origins[joint], axes[joint] = place, rotation[:, 2]
            k, s = np.cos(angle), np.sin(angle)
            x, y = rotation[:, 0].copy(), rotation[:, 1].copy()
            rotation[:, 0], rotation[:, 1] = k * x + s * y, k * y - s * x
        place = place + rotation @ self._origins[-1]
        return Configuration(
            place, rotation @ self._rotations[-1], np.vstack([_cross(axes, place - origins).T, axes.T])
        )

    def step(self, at: Configuration, position: Array, rotation: Array, posture: Array) -> Array:
        """Change of the joints (n,) that moves the tool towards a pose: one step of damped least squares.

        `posture` (n,) is the change that is preferred; it is projected into the null space of the tool's motion.
        """
        error = np.concatenate([position - at.position, _cross(at.rotation.T, rotation.T).sum(0) / 2])
        jacobian = at.jacobian
        square = jacobian @ jacobian.T + self.damping**2 * np.eye(6)
        change: Array = posture + jacobian.T @ np.linalg.solve(square, error - jacobian @ posture)
        return change


def _cross(first: Array, second: Array) -> Array:
    """Cross products of rows (n, 3); `np.cross` takes ten times as long."""
    a, b = np.broadcast_arrays(first, second)
    return np.stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ],
        1,
    )


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
