"""Forward kinematics, Jacobian and damped least squares of a serial arm, computed by `arm_kernel`.

Damped least squares: Nakamura and Hanafusa 1986; null-space term: Liegeois 1977.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from math import atan2, cos, sin
from typing import NamedTuple

import numpy as np

from ..core import Array
from .geometry import Quaternion, Vector, axes, from_axes
from .urdf import Joint


class Pose(NamedTuple):
    """Position of the tool in m and the unit vectors of its frame, z along the direction of approach."""

    position: Vector
    x: Vector
    y: Vector
    z: Vector

    @classmethod
    def at(cls, position: Vector, orientation: Quaternion) -> Pose:
        return cls(position, *axes(orientation))

    @property
    def orientation(self) -> Quaternion:
        return from_axes(self.x, self.y, self.z)


def downward(position: Vector, yaw: float) -> Pose:
    """A tool that points down, its x axis at this yaw, in rad about the world's z."""
    k, s = cos(yaw), sin(yaw)
    return Pose(position, (k, s, 0.0), (s, -k, 0.0), (0.0, 0.0, -1.0))


class Configuration(NamedTuple):
    """A chain at given joint positions."""

    tool: Pose
    numbers: Array
    """The tool's pose, then for each joint its origin in m and the direction of its axis, in the world: (12 + 6 n,)."""

    @property
    def axes(self) -> Array:
        """For each joint its origin in m and the direction of its axis: 6 n numbers."""
        return self.numbers[12:]


def _aligned(axis: Vector) -> Array:
    """A rotation (3, 3) that turns z into `axis`."""
    z = np.array(axis) / np.linalg.norm(axis)
    if z[2] > 1 - 1e-12:
        return np.eye(3)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _numbers(pose: Pose) -> Array:
    (px, py, pz), (ax, ay, az), (bx, by, bz), (cx, cy, cz) = pose
    return np.array((px, py, pz, ax, ay, az, bx, by, bz, cx, cy, cz))


class Stride(NamedTuple):
    """How far an action moves: the tool in m along every axis, each joint (n,) in rad; `gain` draws them home."""

    tool: float
    joints: Array
    gain: float


Numbers = Sequence[float] | Array
"""One number per joint: (n,)."""
Posture = tuple[Sequence[float], float]
"""Preferred joint positions (n,) in rad, and the share of the way to them that a step prefers."""
Limits = tuple[Array, Array]
"""Lower and upper limits of the joints, (n,) each, in rad."""


class Chain:
    """A serial chain of revolute joints from the world to a tool.

    Args:
        joints: from base to wrist, each the child of the previous one.
        tool: translation in m (3,) and rotation (3, 3) of the tool in the frame of the last link.
        base: position of the chain's base in the world, in m.
    """

    damping = 0.02
    """lambda of the damped least squares, in m/rad; it limits joint changes near singularities."""

    def __init__(self, joints: Sequence[Joint], tool: tuple[Array, Array], base: Vector = (0.0, 0.0, 0.0)) -> None:
        self.size = len(joints)
        # Every joint turns about z here: the rotation that aligns its axis is part of its own and the next origin.
        aligned = np.eye(3)
        frames: list[tuple[float, ...]] = []
        for joint in joints:
            turn = _aligned(joint.axis)
            rotation = aligned.T @ np.array(joint.rotation) @ turn
            frames.append((*(aligned.T @ np.array(joint.origin)), *rotation.ravel()))
            aligned = turn
        tool_frame = *(aligned.T @ np.asarray(tool[0])), *(aligned.T @ np.asarray(tool[1])).ravel()
        self.links = np.array([*frames, tool_frame])
        """Translation in m and rotation of each joint and of the tool in the frame before: (n + 1, 12)."""
        self.base = np.array(base, float)
        self._unlimited = np.full(self.size, np.inf)
        self._kernel = import_module(".arm_kernel", __package__)  # heavy, so it is imported when an arm is built
        self._motion = self._kernel.motion.unchecked()

    def forward(self, positions: Numbers) -> Configuration:
        """The chain at joint positions (n,) in rad."""
        numbers = np.empty(12 + 6 * self.size)
        self._kernel.forward(self.base, self.links, self._per_joint(positions), numbers)
        a, b, c, d, e, f, g, h, i, j, k, l = numbers[:12].tolist()  # noqa: E741
        return Configuration(Pose((a, b, c), (d, e, f), (g, h, i), (j, k, l)), numbers)

    def velocity(self, at: Configuration, rates: Numbers) -> Vector:
        """Velocity of the tool in m/s when the joints turn at rates (n,) in rad/s."""
        velocity: Vector = self._kernel.velocity(at.numbers, self._per_joint(rates))
        return velocity

    def motion(self, positions: Array, rates: Array) -> tuple[Configuration, Vector, Vector]:
        """The chain at joint positions (n,) in rad, and the velocity and angular velocity of its tool, m/s and rad/s.

        The joints turn at `rates` (n,) in rad/s. Both are arrays of float64 in one piece.
        """
        numbers = np.empty(12 + 6 * self.size)
        tool, velocity, spin = self._motion(self.base, self.links, positions, rates, numbers)
        return Configuration(Pose(*tool), numbers), velocity, spin

    def jacobian(self, at: Configuration) -> Array:
        """(6, n): velocity of the tool in m/s, then its angular velocity in rad/s, per rad/s of each joint."""
        rows = np.empty((self.size, 6))
        self._kernel.jacobian(at.numbers, rows)
        return rows.T

    def step(self, at: Configuration, target: Pose, posture: Numbers, most: Array | None = None) -> Array:
        """Change of the joints (n,) in rad that moves the tool towards a pose: one step of damped least squares.

        Args:
            posture: preferred change (n,) in rad, projected into the null space of the tool's motion.
            most: largest change of each joint (n,) in rad; all changes are scaled down until none exceeds it.
        """
        change, limits = np.empty(self.size), self._unlimited if most is None else most
        self._kernel.step(at.numbers, _numbers(target), self._per_joint(posture), self.damping, limits, change)
        return change

    def led(self, positions: Numbers, target: Pose, limits: Limits, posture: Posture, steps: int) -> Array:
        """Joint positions (n,) in rad with the tool at a pose, by at most `steps` calls of `step` from `positions`.

        If they do not get there, the last positions are returned: look where the tool is.
        """
        pose, (rest, gain) = self._per_joint(positions).copy(), posture
        wanted, preferred = _numbers(target), self._per_joint(rest)
        self._kernel.lead(self.base, self.links, pose, wanted, preferred, gain, self.damping, *limits, steps)
        return pose

    def walked(self, home: Numbers, place: Sequence[float], limits: Limits, stride: Stride, steps: int) -> Array:
        """Joint positions (n,) to which actions lead a tool that points down, from home towards a place in m.

        In each of the steps the tool moves at most by `stride.tool` along every axis, and no joint by more than its
        `stride.joints`: all are slower then. They are drawn towards home.
        """
        pose, at, tool = self._per_joint(home).copy(), np.array(place, float), self.forward(home).tool
        target = _numbers(downward(tool.position, atan2(tool.x[1], tool.x[0])))  # its position changes in each step
        arguments = self.base, self.links, pose, target, at, stride.tool, stride.joints, stride.gain, self.damping
        self._kernel.walk(*arguments, *limits, steps)
        return pose

    def _per_joint(self, numbers: Numbers) -> Array:
        """The numbers as an array (n,). Raises ValueError unless there is one number per joint."""
        array = np.asarray(numbers, float)
        if array.shape != (self.size,):
            raise ValueError(f"{array.size} numbers for {self.size} joints")
        return array
