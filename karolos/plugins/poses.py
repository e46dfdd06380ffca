"""Home pose and workspace of an arm, by kinematics alone."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import atan2, cos, pi, sin
from typing import NamedTuple

import numpy as np

from ..core import Array
from ..core.seeding import Generator, SeedTree
from ..robots.arm import POSTURE_GAIN
from ..simulation.geometry import Box, Vector
from ..simulation.kinematics import Chain
from ..simulation.urdf import Joint

STARTS = 6
"""Random joint positions from which inverse kinematics looks for a home pose, for each place and yaw of the tool."""
YAWS = (0.0, pi / 2, pi, 3 * pi / 2)
MARGIN = 0.1
"""Distance in rad from the limits of the joints that home and workspace keep."""
SPEED = 0.8
"""Fraction of the joints' speeds that a full action may take at home."""
SMALLEST = 0.04
"""Least edge of a workspace in m."""
GOALS = 0.3
"""Edges in m of the box from which tasks draw goals."""
CLEARANCE = 0.015
"""Least height in m of the joints above the floor, but for the first."""


class Place(NamedTuple):
    """A home pose and what can be done around it."""

    home: tuple[float, ...]
    """Joint positions in rad."""
    tool_step: float
    """The distance in m that the tool can move per control step along every axis."""
    workspace: Box
    tool: Vector
    """Position of the tool at home in m."""

    @property
    def edge(self) -> float:
        """The shortest edge of the workspace in m."""
        return float(np.subtract(self.workspace.high, self.workspace.low).min())

    @property
    def room(self) -> float:
        """Volume in m3 of the workspace as far as tasks use it.

        Half of it counts if the workspace does not reach the floor, and half if the tool at home cannot move by four
        steps to every side.
        """
        low, high = np.array(self.workspace.low), np.array(self.workspace.high)
        free = min((self.tool - low).min(), (high - self.tool).min()) > 4 * self.tool_step
        return float(np.prod(np.minimum(high - low, GOALS))) * (0.5 if low[2] > 0.05 else 1.0) * (1.0 if free else 0.5)


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
        low, high = (np.array([getattr(joint, end) for joint in joints]) for end in ("lower", "upper"))
        turns = high - low > 2 * pi
        low, high = np.where(turns, np.maximum(low, -pi), low), np.where(turns, np.minimum(high, pi), high)
        margin = np.minimum(MARGIN, (high - low) / 10)
        self.low, self.high = low + margin, high - margin
        inside = (low < -(high - low) / 10) & (high > (high - low) / 10)
        self.rest = np.where(inside, 0.0, (low + high) / 2)
        """Joint positions that are preferred: 0, or the middle of a range that 0 is not well within."""
        self.shoulder = self.chain.forward(self.rest.tolist()).axes[8]
        """Height of the second joint in m."""
        self.speeds = np.array([joint.velocity for joint in joints])

    def best(self, largest_step: float) -> Place | None:
        """The home pose with the roomiest workspace; None if the tool cannot point down anywhere around the base.

        The search begins in front of the base, with the tool a quarter of the arm's length above the floor. It goes on
        lower, and then to the sides, until the goals of the tasks have room.
        """
        draws = SeedTree(0).generator()
        lift = max(0.0, self.shoulder / self.length - 0.45)  # of a base on a pedestal
        best: Place | None = None
        for direction, height in product((0.0, -pi / 2, pi / 2, pi), (0.25, 0.15, 0.08)):
            if best is not None and direction and best.edge > SMALLEST:
                break
            for ahead in (0.55, 0.45, 0.65, 0.35):
                place = np.array([ahead * cos(direction), ahead * sin(direction), lift + height])
                x, y, z = (self.length * place).tolist()
                for home in self._homes((x, y, z), draws):
                    step = min(largest_step, self._tool_step(home))
                    found = Place(home, step, self._workspace(home, step), self.chain.forward(home).tool.position)
                    best = found if best is None or found.room > 1.1 * best.room else best
            if best is not None and best.room > 0.9 * GOALS**3:
                break
        return best

    def _homes(self, target: Vector, draws: Generator) -> list[tuple[float, ...]]:
        """At most two different poses with the tool at `target`, pointing down, the best first.

        They are computed from random starts. Good ones are far from joint limits and singularities, with joints above
        the floor and near those preferred.
        """
        found: list[tuple[float, Array, float]] = []

        def solve(pose: Array, yaw: float) -> Array:
            pose = self._solved(pose, target, yaw)
            score = self._score(pose, target)
            if score is not None:
                found.append((score, pose, yaw))
            return pose

        for yaw, start in product(YAWS, range(STARTS)):
            solve(self.rest + (1.0 if start % 2 else 0.3) * (draws.uniform(self.low, self.high) - self.rest), yaw)
        if found:  # the best with the tool turned: a redundant arm may be straighter
            _, pose, yaw = max(found, key=lambda one: one[0])
            for turn in YAWS[1:]:
                pose = solve(pose, yaw + turn)
        homes: list[Array] = []
        for _, pose, yaw in sorted(found, key=lambda one: -one[0]):
            if len(homes) < 2 and all(np.abs(pose - other)[:-1].max() > 0.5 for other in homes):
                homes.append(self._solved(pose, target, yaw, steps=500))
        return [tuple(round(float(value), 4) + 0.0 for value in pose) for pose in homes]

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
        return min(margin, 0.5) + 4 * min(dexterity, 0.1) + 0.5 * max(heights) / self.length - 0.1 * bent

    def _tool_step(self, home: Sequence[float]) -> float:
        """The distance in m that the tool can move per control step along every axis from home."""
        inverse = np.abs(np.linalg.pinv(self.chain.jacobian(self.chain.forward(home)))[:, :3])
        return float(np.floor(1000 * SPEED / 24 / (inverse / self.speeds[:, None]).max()) / 1000)

    def _workspace(self, home: tuple[float, ...], tool_step: float) -> Box:
        """A box around home that the tool reaches pointing down, down to the floor.

        It grows face by face from home, to at most 40 % of the arm's length ahead and 60 % across. Of a box that grows
        to all sides alike and one that first grows to its sides the larger is taken.
        """
        sides, ahead = [(0, 1), (1, 1)], [(0, 0), (1, 0), (1, 2)]
        boxes = [self._grown(home, tool_step, phases) for phases in ([[*sides, *ahead]], [sides, ahead])]
        tool = self.chain.forward(home).tool.position
        return max(boxes, key=lambda box: Place(home, tool_step, box, tool).room)

    def _grown(self, home: Sequence[float], tool_step: float, phases: Sequence[Sequence[tuple[int, int]]]) -> Box:
        """A box whose faces (side, axis) grow phase by phase, after the lower one has grown to the floor."""
        start = np.array(self.chain.forward(home).tool.position)
        ahead, across, up = 0.2 * self.length, 0.3 * self.length, 0.25 * self.length
        most = np.array([[-ahead, -across, min(0.0, 0.02 - start[2])], [ahead, across, up]])
        size = np.zeros((2, 3))
        for phase, fraction in product(([(0, 2)], *phases), (10, 20, 40, 80)):
            growing = list(phase)
            while growing:
                for side, axis in [*growing]:
                    face, larger = (side, axis), size.copy()
                    larger[face] += (2 * side - 1) * self.length / fraction
                    larger[face] = np.clip(larger[face], most[0, axis], most[1, axis])
                    if larger[face] == size[face] or not self._face_reached(home, start, larger, face, tool_step):
                        growing.remove(face)
                    else:
                        size = larger
        start = 1000 * start
        low = np.minimum(np.ceil(start + 1000 * size[0]), np.floor(start)) / 1000
        high = np.maximum(np.floor(start + 1000 * size[1]), np.ceil(start)) / 1000
        (x, y, z), (u, v, w) = low.tolist(), high.tolist()
        return Box((x, y, z), (u, v, w))

    def _face_reached(
        self, home: Sequence[float], start: Array, size: Array, face: tuple[int, int], tool_step: float
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
