"""Forward kinematics, Jacobian and damped least squares of a serial arm.

Plain floats take half the time of numpy arrays for a single arm.
Damped least squares: Nakamura and Hanafusa 1986; null-space term: Liegeois 1977.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv

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
    axes: list[float]
    """For each joint its origin in m and the direction of its axis, in world coordinates: 6 n numbers."""


def _aligned(axis: Vector) -> Array:
    """A rotation (3, 3) that turns z into `axis`."""
    z = np.array(axis) / np.linalg.norm(axis)
    if z[2] > 1 - 1e-12:
        return np.eye(3)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


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
        self.base = base
        # Every joint turns about z here: the rotation that aligns its axis is part of its own and the next origin.
        aligned = np.eye(3)
        frames: list[tuple[float, ...]] = []
        for joint in joints:
            turn = _aligned(joint.axis)
            rotation = aligned.T @ np.array(joint.rotation) @ turn
            frames.append((*(aligned.T @ np.array(joint.origin)), *rotation.ravel()))
            aligned = turn
        self._frames = tuple(tuple(float(value) for value in frame) for frame in frames)
        translation, rotation = aligned.T @ np.asarray(tool[0]), aligned.T @ np.asarray(tool[1])
        self._tool = tuple(float(value) for value in (*translation, *rotation.ravel()))
        self._identity = np.eye(6) * self.damping**2

    def forward(self, positions: Sequence[float]) -> Configuration:
        """The chain at joint positions (n,) in rad."""
        px, py, pz = self.base
        xx, xy, xz, yx, yy, yz, zx, zy, zz = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
        axes: list[float] = []
        for angle, (ox, oy, oz, a, b, c, d, e, f, g, h, i) in zip(positions, self._frames, strict=True):
            px += xx * ox + yx * oy + zx * oz
            py += xy * ox + yy * oy + zy * oz
            pz += xz * ox + yz * oy + zz * oz
            # columns of R * (origin's rotation); its third column is the axis
            ux, uy, uz = xx * a + yx * d + zx * g, xy * a + yy * d + zy * g, xz * a + yz * d + zz * g
            vx, vy, vz = xx * b + yx * e + zx * h, xy * b + yy * e + zy * h, xz * b + yz * e + zz * h
            zx, zy, zz = xx * c + yx * f + zx * i, xy * c + yy * f + zy * i, xz * c + yz * f + zz * i
            k, s = cos(angle), sin(angle)
            xx, xy, xz = k * ux + s * vx, k * uy + s * vy, k * uz + s * vz
            yx, yy, yz = k * vx - s * ux, k * vy - s * uy, k * vz - s * uz
            axes += (px, py, pz, zx, zy, zz)
        ox, oy, oz, a, b, c, d, e, f, g, h, i = self._tool
        pose = Pose(
            (px + xx * ox + yx * oy + zx * oz, py + xy * ox + yy * oy + zy * oz, pz + xz * ox + yz * oy + zz * oz),
            (xx * a + yx * d + zx * g, xy * a + yy * d + zy * g, xz * a + yz * d + zz * g),
            (xx * b + yx * e + zx * h, xy * b + yy * e + zy * h, xz * b + yz * e + zz * h),
            (xx * c + yx * f + zx * i, xy * c + yy * f + zy * i, xz * c + yz * f + zz * i),
        )
        return Configuration(pose, axes)

    @staticmethod
    def velocity(at: Configuration, rates: Sequence[float]) -> Vector:
        """Velocity of the tool in m/s when the joints turn at rates (n,) in rad/s."""
        tx, ty, tz = at.tool.position
        vx = vy = vz = 0.0
        for rate, px, py, pz, ax, ay, az in zip(rates, *[iter(at.axes)] * 6, strict=True):
            rx, ry, rz = tx - px, ty - py, tz - pz
            vx += rate * (ay * rz - az * ry)
            vy += rate * (az * rx - ax * rz)
            vz += rate * (ax * ry - ay * rx)
        return vx, vy, vz

    @staticmethod
    def spin(at: Configuration, rates: Sequence[float]) -> Vector:
        """Angular velocity of the tool in rad/s when the joints turn at rates (n,) in rad/s."""
        wx = wy = wz = 0.0
        for rate, _, _, _, ax, ay, az in zip(rates, *[iter(at.axes)] * 6, strict=True):
            wx += rate * ax
            wy += rate * ay
            wz += rate * az
        return wx, wy, wz

    @staticmethod
    def jacobian(at: Configuration) -> Array:
        """(6, n): velocity of the tool in m/s, then its angular velocity in rad/s, per rad/s of each joint."""
        tx, ty, tz = at.tool.position
        numbers: list[float] = []
        for px, py, pz, ax, ay, az in zip(*[iter(at.axes)] * 6, strict=True):
            rx, ry, rz = tx - px, ty - py, tz - pz
            numbers += (ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx, ax, ay, az)
        return np.array(numbers).reshape(-1, 6).T

    def step(self, at: Configuration, target: Pose, posture: Sequence[float]) -> list[float]:
        """Change of the joints (n,) in rad that moves the tool towards a pose: one step of damped least squares.

        Args:
            at: the current configuration.
            target: of the tool.
            posture: preferred change (n,) in rad, projected into the null space of the tool's motion.
        """
        jacobian = self.jacobian(at)
        (px, py, pz), (ax, ay, az), (bx, by, bz), (cx, cy, cz) = at.tool
        (qx, qy, qz), (dx, dy, dz), (ex, ey, ez), (fx, fy, fz) = target
        # half the sum of the cross products of the frame's axes with those wanted; for small errors this is the
        # rotation vector (Luh, Walker, Paul 1980)
        numbers = np.array(
            (
                qx - px,
                qy - py,
                qz - pz,
                0.5 * (ay * dz - az * dy + by * ez - bz * ey + cy * fz - cz * fy),
                0.5 * (az * dx - ax * dz + bz * ex - bx * ez + cz * fx - cx * fz),
                0.5 * (ax * dy - ay * dx + bx * ey - by * ex + cx * fy - cy * fx),
                *posture,
            )
        )
        error, preferred = numbers[:6], numbers[6:]
        square = jacobian @ jacobian.T
        square += self._identity
        weights = dposv(square, error - jacobian @ preferred)[1]
        change: list[float] = (preferred + weights @ jacobian).tolist()
        return change
