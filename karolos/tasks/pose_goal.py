"""Goals that are poses: position and orientation."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi, sin, sqrt

import numpy as np

from ..core import Array, BoolArray, Field, FloatArray, Generator
from ..errors import UsageError
from ..simulation.geometry import Orientations, Quaternion, Vector, angles, columns, matrix_of
from ..simulation.interface import Box, RobotView
from .point_goal import PointGoal

METRES_PER_RADIAN = 0.1
"""Cost in m of a radian in a dense reward."""


def pose_fields(what: str) -> tuple[Field, Field]:
    """The layout of a pose in a goal: its position in m, then the first two columns of its rotation matrix."""
    return Field(f"{what}_position", 3, "m", kind="point"), Field(f"{what}_rotation", 6, kind="rotation")


def pose_array(position: Sequence[float], orientation: Quaternion) -> FloatArray:
    """A pose in the form of a goal: (9,)."""
    return np.array([*position, *columns(orientation)], np.float32)


def sample_orientation(generator: Generator, orientations: Orientations) -> Quaternion:
    """A random one of these orientations: its tilt uniform in a disc and its turn uniform in a range."""
    tilt, direction = orientations.tilt * sqrt(generator.uniform()), generator.uniform(-pi, pi)
    turn = generator.uniform(-orientations.turn, orientations.turn)
    return orientations.at(tilt * cos(direction), tilt * sin(direction), turn)


def check_turning(robot: RobotView) -> Box:
    """Where the robot can turn its tool. Raises UsageError if actions do not turn it, or the space is unknown."""
    if not robot.orientations.tilt:
        hint = "set robot.control: pose"
        raise UsageError("these actions do not turn the tool", setting="robot.control", hint=hint)
    if robot.dexterous is None:
        hint = "declare `dexterous` in its model"
        raise UsageError("it is unknown where this robot can turn its tool", setting="robot", hint=hint)
    return robot.dexterous


class PoseGoal(PointGoal):
    """Success if position and orientation of `achieved` (..., 9) are both near those of `desired` (..., 9).

    Sparse reward: 0 on success, else -1. Dense reward: minus the distance in m, minus .1 m per rad of the angle.

    Args:
        threshold: distance under which the position is reached, m.
        angle_threshold: angle under which the orientation is reached, rad: that of the rotation between the two.
        span: largest possible distance in m; it bounds the dense reward.
        symmetries: turns of the moved object about its own axes that do not change it, without the turn by 0: a square
            peg has three, by 90, 180 and 270 degrees.
        axis: symmetry axis of an object that any turn about it leaves unchanged. Only directions of this axis are
            compared. If a symmetry reverses it, both directions are the same.
    """

    place = slice(3)

    def __init__(
        self,
        threshold: float,
        angle_threshold: float,
        *,
        dense: bool,
        span: float,
        symmetries: Sequence[Quaternion] = (),
        axis: Vector | None = None,
    ) -> None:
        super().__init__(threshold, dense=dense, span=span + METRES_PER_RADIAN * pi)
        self.angle_threshold = angle_threshold
        turns = [matrix_of(one).ravel() for one in ((0.0, 0.0, 0.0, 1.0), *symmetries)] if symmetries else []
        self._turns = np.array(turns, np.float32)
        """Their rotation matrices (k, 9), beginning with the turn by 0."""
        self._axis = None if axis is None else np.float32(np.divide(axis, np.linalg.norm(axis)))
        self._reversed = axis is not None and any(np.dot(matrix_of(one) @ axis, axis) < 0 for one in symmetries)

    def loss(self, achieved: Array, desired: Array) -> FloatArray:
        lost = self.distance(achieved, desired) + np.float32(METRES_PER_RADIAN) * self.angle(achieved, desired)
        return np.asarray(lost, np.float32)

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        near = super().success(achieved, desired)
        return near & (self.angle(achieved, desired) < self.angle_threshold) if near.any() else near

    def angle(self, achieved: Array, desired: Array) -> FloatArray:
        first, second = achieved[..., 3:], desired[..., 3:]
        if self._axis is not None:
            cosine = np.vecdot(_frame(first) @ self._axis, _frame(second) @ self._axis)
            cosine = np.abs(cosine) if self._reversed else cosine
            between: FloatArray = np.arccos(np.clip(cosine, -1, 1), dtype=np.float32)
            return between
        if not len(self._turns):
            return angles(first, second)
        turned = np.swapaxes(_frame(first), -1, -2) @ _frame(second)
        traces = np.vecdot(turned.reshape(*first.shape[:-1], 1, 9), self._turns).max(-1)
        found: FloatArray = np.arccos(np.clip((traces - 1) / 2, -1, 1), dtype=np.float32)
        return found


def _frame(rotation: Array) -> Array:
    """Rotation matrices (..., 3, 3) of two columns (..., 6)."""
    x, y = rotation[..., :3], rotation[..., 3:]
    (a, b, c), (d, e, f) = np.moveaxis(x, -1, 0), np.moveaxis(y, -1, 0)
    z = np.stack([b * f - c * e, c * d - a * f, a * e - b * d], -1)  # np.cross takes five times as long
    return np.stack([x, y, z], -1)
