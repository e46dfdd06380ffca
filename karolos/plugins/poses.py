"""Home pose and workspace of an arm, by kinematics alone."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import atan2, pi

import numpy as np

from ..core import Array
from ..core.seeding import SeedTree
from ..robots.arm import POSTURE_GAIN
from ..simulation.geometry import Box, Vector
from ..simulation.kinematics import Chain
from ..simulation.urdf import Joint

STARTS = 12
"""Random joint positions from which inverse kinematics looks for a home pose, for each place and yaw of the tool."""
MARGIN = 0.1
"""Distance in rad from the limits of the joints that home and workspace keep."""
SPEED = 0.8
"""Fraction of the joints' speeds that a full action may take at home."""
GOALS = 0.3
"""Edges in m of the box from which tasks draw goals."""
CLEARANCE = 0.015
"""Least height in m of the joints above the floor, but for the first."""


class Poses:
    """An arm with its tool.

    Args:
        joints: from base to wrist.
        tool: translation in m and rotation (3, 3) of the tool in the frame of the last link.
    """

    def __init__(self, joints: Sequence[Joint], tool: tuple[Array, Array]) -> None:
        self.chain = Chain(joints, tool)
        self.length = sum(float(np.linalg.norm(one.origin)) for one in joints[1:]) + float(np.linalg.norm(tool[0]))
        """Of the arm from its second joint to the tool, in m."""
        self.shoulder = joints[0].origin[2] + joints[1].origin[2]
        low = np.array([max(joint.lower, -pi) for joint in joints])
        high = np.array([min(joint.upper, pi) for joint in joints])
        margin = np.minimum(MARGIN, (high - low) / 10)
        self.low, self.high = low + margin, high - margin
        self.rest = np.clip(0.0, self.low, self.high)
        self.speeds = np.array([joint.velocity for joint in joints])

    def homes(self) -> list[tuple[float, ...]]:
        """Joint positions with the tool pointing down at several distances in front of the base, at the same height.

        Many poses are computed from random starts. For each distance the one is taken that is furthest from joint
        limits and singularities, with joints above the floor and near 0.
        """
        draws = SeedTree(0).generator()
        homes = []
        for height in sorted({max(0.25 * self.length, height) for height in (0.0, self.shoulder - 0.3 * self.length)}):
            for ahead in (0.45, 0.55, 0.65):
                target = (ahead * self.length, 0.0, height)
                found: list[tuple[float, Array, float]] = []
                for yaw, start in product((0.0, pi / 2, -pi / 2, pi), range(STARTS)):
                    offset = draws.uniform(self.low, self.high) - self.rest
                    pose = self._solved(self.rest + (1.0 if start % 2 else 0.3) * offset, target, yaw)
                    score = self._score(pose, target)
                    if score is not None:
                        found.append((score, pose, yaw))
                if found:
                    _, pose, yaw = max(found, key=lambda one: one[0])
                    pose = self._solved(pose, target, yaw, steps=500)
                    homes.append(tuple(round(float(value), 4) + 0.0 for value in pose))
            if homes:
                break
        return homes

    def _solved(self, pose: Array, target: Vector, yaw: float, steps: int = 60) -> Array:
        """A pose (n,) near this one with the tool at `target`, pointing down, if inverse kinematics finds one."""
        for _ in range(steps):
            posture = (POSTURE_GAIN * (self.rest - pose)).tolist()
            change = self.chain.step(self.chain.forward(pose.tolist()), target, yaw, posture)
            pose = np.clip(pose + np.clip(change, -0.5, 0.5), self.low, self.high)
        return pose

    def _score(self, pose: Array, target: Vector) -> float | None:
        """How good a home pose is. None: the tool is not there or does not point down, or a joint is in the floor."""
        at = self.chain.forward(pose.tolist())
        heights = at.axes[2::6]
        off = float(np.linalg.norm(np.subtract(at.tool.position, target)))
        if off > 1e-3 or at.tool.z[2] > -1 + 1e-6 or min(heights[1:]) < CLEARANCE:
            return None
        jacobian = self.chain.jacobian(at)
        jacobian[:3] /= self.length
        margin = float(np.minimum(pose - self.low, self.high - pose).min())
        dexterity = float(np.linalg.svd(jacobian, compute_uv=False)[-1])
        bent = float(np.abs(pose - self.rest).sum())
        return min(margin, 0.5) + 4 * min(dexterity, 0.2) + 0.5 * max(heights) / self.length - 0.05 * bent

    def tool_step(self, home: Sequence[float]) -> float:
        """The distance in m that the tool can move per control step along every axis from home."""
        inverse = np.abs(np.linalg.pinv(self.chain.jacobian(self.chain.forward(home)))[:, :3])
        return float(np.floor(1000 * SPEED / 24 / (inverse / self.speeds[:, None]).max()) / 1000)

    def workspace(self, home: Sequence[float], tool_step: float) -> Box:
        """A box around home that the tool reaches pointing down, down to the floor.

        It grows face by face from home, to at most 40 % of the arm's length ahead and 60 % across. Of a box that grows
        to all sides alike and one that first grows to its sides the larger is taken.
        """
        sides, ahead = [(0, 1), (1, 1)], [(0, 0), (1, 0), (1, 2)]
        boxes = [self._grown(home, tool_step, phases) for phases in ([[*sides, *ahead]], [sides, ahead])]
        return max(boxes, key=self.room)

    @staticmethod
    def room(box: Box) -> tuple[float, float]:
        """How much room a workspace has: first as far as the goals of the tasks use it, then its volume in m3."""
        edges = np.subtract(box.high, box.low)
        return float(np.prod(np.minimum(edges, GOALS))), float(np.prod(edges))

    def _grown(self, home: Sequence[float], tool_step: float, phases: Sequence[Sequence[tuple[int, int]]]) -> Box:
        """A box whose faces (side, axis) grow phase by phase, after the lower one has grown to the floor."""
        start = self.chain.forward(home).tool.position
        unit = self.length / 40
        most = np.array([[-8 * unit, -12 * unit, min(0.0, 0.02 - start[2])], [8 * unit, 12 * unit, 10 * unit]])
        size = np.zeros((2, 3))
        for phase in ([(0, 2)], *phases):
            growing = list(phase)
            while growing:
                for side, axis in [*growing]:
                    face, larger = (side, axis), size.copy()
                    larger[face] = np.clip(size[face] + (2 * side - 1) * unit, most[0, axis], most[1, axis])
                    if larger[face] == size[face] or not self._face_reached(home, start, larger, face, tool_step):
                        growing.remove(face)
                    else:
                        size = larger
        low, high = np.ceil((start + size[0]) * 1000) / 1000, np.floor((start + size[1]) * 1000) / 1000
        (x, y, z), (u, v, w) = low.tolist(), high.tolist()
        return Box((x, y, z), (u, v, w))

    def _face_reached(
        self, home: Sequence[float], start: Vector, size: Array, face: tuple[int, int], tool_step: float
    ) -> bool:
        """Whether the tool reaches the corners and the centres of one face of a box and of its edges."""
        side, axis = face
        yaw = atan2(*reversed(self.chain.forward(home).tool.x[:2]))
        fractions = [one for one in product((0.0, 1.0, 0.5), repeat=3) if one[axis] == side]
        places = [start + size[0] + np.array(one) * (size[1] - size[0]) for one in fractions]
        return all(self._reached(home, place, yaw, tool_step) for place in places)

    def _reached(self, home: Sequence[float], place: Array, yaw: float, tool_step: float) -> bool:
        """Whether an arm that moves as actions move it comes from home to a place in 40 control steps."""
        pose = np.array(home)
        steps = np.minimum(0.5, self.speeds / 24)
        for _ in range(40):
            at = self.chain.forward(pose.tolist())
            offset = place - at.tool.position
            if np.abs(offset).max() < 5e-4:
                break
            x, y, z = (at.tool.position + offset / max(1.0, float(np.abs(offset).max()) / tool_step)).tolist()
            change = np.array(self.chain.step(at, (x, y, z), yaw, (POSTURE_GAIN * (home - pose)).tolist()))
            pose = pose + change / max(1.0, float((np.abs(change) / steps).max()))
            if (pose < self.low).any() or (pose > self.high).any():
                return False
        at = self.chain.forward(pose.tolist())
        return float(np.linalg.norm(place - at.tool.position)) < 0.002 and min(at.axes[2::6][1:]) > CLEARANCE
