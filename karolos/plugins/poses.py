"""Home pose and workspace of an arm, by kinematics alone."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import atan2, cos, pi, sin
from typing import NamedTuple

import numpy as np

from ..core import Array
from ..core.seeding import SeedTree
from ..robots.arm import POSTURE_GAIN
from ..robots.model import ArmModel
from ..simulation.geometry import Box, Orientations, Vector
from ..simulation.kinematics import Chain, Pose, downward
from ..simulation.urdf import Joint

STARTS = 6
"""Random joint positions from which inverse kinematics looks for a home pose, for each yaw of the tool."""
TILTS = tuple((cos(way), sin(way)) for way in (0.0, pi / 3, 2 * pi / 3, pi, 4 * pi / 3, 5 * pi / 3))
"""Directions in which the tool is tilted to see where it can be."""
YAWS = (0.0, pi / 2, pi, 3 * pi / 2)
LIMIT_DISTANCE = 0.1
"""Distance in rad from the limits of the joints that home and workspace keep."""
HOME_SPEED = 0.8
"""Fraction of the joints' speeds that a full action may take at home."""
SMALLEST_WORKSPACE = 0.04
"""Least edge of a workspace in m."""
GOAL_SPACE = 0.3
"""Edges in m of the box from which tasks draw goals."""
CLEARANCE = 0.015
"""Least height in m of the joints above the floor, but for the first."""


class Place(NamedTuple):
    """A home pose and what can be done around it."""

    room: float
    """Volume in m3 of the workspace as far as tasks use it; less if it is not on the floor, if the tool is slow, or if
    home is so near a face that four steps lead out of it."""
    home: tuple[float, ...]
    """Joint positions in rad."""
    tool: Vector
    """Position of the tool at home in m."""
    tool_step: float
    """The distance in m that the tool can move per control step along every axis."""
    workspace: Box


class Poses:
    """An arm with its tool.

    Args:
        joints: from base to wrist.
        tool: translation in m and rotation (3, 3) of the tool in the frame of the last link.
        largest_step: in m that the tool shall move per control step.
    """

    def __init__(self, joints: Sequence[Joint], tool: tuple[Array, Array], largest_step: float) -> None:
        self.chain, self.largest_step = Chain(joints, tool), largest_step
        self.length = sum(float(np.linalg.norm(one.origin)) for one in joints[1:]) + float(np.linalg.norm(tool[0]))
        """Of the arm from its second joint to the tool, in m."""
        low, high = (np.array([getattr(joint, end) for joint in joints]) for end in ("lower", "upper"))
        turns = high - low > 2 * pi
        low, high = np.where(turns, np.maximum(low, -pi), low), np.where(turns, np.minimum(high, pi), high)
        distance = np.minimum(LIMIT_DISTANCE, (high - low) / 10)
        self.low, self.high = low + distance, high - distance
        inside = (low < -(high - low) / 10) & (high > (high - low) / 10)
        self.rest = np.where(inside, 0.0, (low + high) / 2)
        """Joint positions that are preferred: 0, or the middle of a range that 0 is not well within."""
        self.speeds = np.array([joint.velocity for joint in joints])

    def best(self) -> Place | None:
        """The home pose with the roomiest workspace; None if the tool cannot point down anywhere around the base.

        The search begins in front of the base, with the tool a quarter of the arm's length above the floor. It goes on
        lower, far below the shoulder of an arm that stands or hangs high, and then to the sides, until the goals of the
        tasks have room.
        """
        shoulder = self.chain.forward(self.rest.tolist()).axes[8]  # height of the second joint
        lift = max(0.0, shoulder / self.length - 0.45)  # of a base on a pedestal
        best: Place | None = None
        below = (-0.1, -0.25, -0.4) if lift else ()
        ahead = product((0.0,), (0.25, 0.15, 0.08, *below), (0.55, 0.45, 0.65, 0.35))
        for direction, height, away in (*ahead, *product((-pi / 2, pi / 2, pi), (0.25, 0.15), (0.55, 0.35))):
            if best is not None and (best.room > 0.9 * GOAL_SPACE**3 or direction):
                break
            x, y, z = (away * cos(direction), away * sin(direction), lift + height)
            found = self._at((self.length * x, self.length * y, self.length * z))
            if found is not None and found.room > (1.25 * best.room if best else 0.0):
                best = found
        return best

    def _at(self, target: Vector) -> Place | None:
        """The best of the poses with the tool at `target`, pointing down, that inverse kinematics finds.

        It is far from joint limits and fast in every direction, with joints above the floor and near those preferred.
        """
        draws = SeedTree(0).generator()
        found: list[tuple[float, list[float], float]] = []

        def look(start: Array, yaw: float) -> None:
            pose = self._solved(start, target, yaw, self.rest, 60)
            if self._reaches(pose, target):
                distance = float(np.minimum(pose - self.low, self.high - pose).min())
                elbow = max(self.chain.forward(pose.tolist()).axes[2::6]) / self.length
                bent = float(np.abs(pose - self.rest).sum())
                fast = 12 * min(self._tool_step(pose), 2 * self.largest_step)
                found.append((min(distance, 0.5) + fast + 0.5 * elbow - 0.1 * bent, pose.tolist(), yaw))

        for yaw, start in product(YAWS, range(STARTS)):
            look(self.rest + (1.0 if start % 2 else 0.3) * (draws.uniform(self.low, self.high) - self.rest), yaw)
        if not found:
            return None
        for yaw in YAWS:  # a redundant arm may be straighter with the tool turned
            look(np.array(max(found)[1]), yaw)
        _, best, yaw = max(found)
        home = tuple(round(float(one), 4) + 0.0 for one in self._solved(np.array(best), target, yaw, self.rest, 500))
        step, box = min(self._tool_step(np.array(home)), self.largest_step), self._workspace(home)
        tool, edges = self.chain.forward(home).tool.position, np.subtract(box.high, box.low)
        free = min(np.subtract(tool, box.low).min(), np.subtract(box.high, tool).min()) > 4 * step
        room = float(np.prod(np.minimum(edges, GOAL_SPACE))) * step / self.largest_step
        room *= (0.5 if box.low[2] > 0.05 else 1.0) * (1.0 if free else 0.5)
        return Place(room if edges.min() >= SMALLEST_WORKSPACE else 0.0, home, tool, step, box)

    def dexterous(self, place: Place) -> Box | None:
        """A part of the workspace, around home, in which the tool can be turned as an `ArmModel` says by default.

        The first of some sizes in which it can be; None if it is too small.
        """
        home, rest = self.chain.forward(place.home).tool, np.array(place.home)
        around = Orientations(home.orientation, ArmModel.tilt, ArmModel.turn)
        turns = [
            around.at(around.tilt * x, around.tilt * y, turn)
            for (x, y), turn in product(TILTS, (-around.turn, around.turn))
        ]
        for share in (0.9, 0.75, 0.6, 0.45, 0.3):
            low, high = (
                np.round(home.position + share * np.subtract(end, home.position), 3)
                for end in (place.workspace.low, place.workspace.high)
            )
            corners = product(*zip(low.tolist(), ((low + high) / 2).tolist(), high.tolist(), strict=True))
            goals = (Pose.at(at, turn) for at, turn in product(corners, turns))
            if all(self._takes(self._led(rest, goal, rest, 60), goal) for goal in goals):
                (a, b, c), (d, e, f) = low.tolist(), high.tolist()
                return Box((a, b, c), (d, e, f))
        return None

    def _solved(self, pose: Array, target: Vector, yaw: float, rest: Array, steps: int) -> Array:
        """A pose (n,) near this one with the tool at `target`, pointing down, if inverse kinematics finds one."""
        return self._led(pose, downward(target, yaw), rest, steps)

    def _led(self, pose: Array, target: Pose, rest: Array, steps: int) -> Array:
        """A pose (n,) near this one with the tool there, if inverse kinematics finds one."""
        for _ in range(steps):
            at = self.chain.forward(pose.tolist())
            change = np.array(self.chain.step(at, target, (POSTURE_GAIN * (rest - pose)).tolist()))
            pose = np.clip(pose + np.clip(change, -0.5, 0.5), self.low, self.high)
            if np.abs(change).max() < 1e-6:
                break
        return pose

    def _reaches(self, pose: Array, target: Vector) -> bool:
        """Whether the tool is at `target` and points down, with all joints above the floor."""
        at = self.chain.forward(pose.tolist())
        off = float(np.linalg.norm(np.subtract(at.tool.position, target)))
        return off < 1e-3 and at.tool.z[2] < -1 + 1e-5 and min(at.axes[8::6]) > CLEARANCE

    def _takes(self, pose: Array, target: Pose) -> bool:
        """Whether the tool has this position and orientation, with all joints above the floor."""
        at = self.chain.forward(pose.tolist())
        off = (float(np.linalg.norm(np.subtract(*pair))) for pair in zip(at.tool, target, strict=True))
        return max(off) < 2e-3 and min(at.axes[8::6]) > CLEARANCE

    def _tool_step(self, home: Array) -> float:
        """The distance in m that the tool can move per control step along every axis from home."""
        inverse = np.abs(np.linalg.pinv(self.chain.jacobian(self.chain.forward(home.tolist())))[:, :3])
        return float(np.floor(1000 * HOME_SPEED / 24 / (inverse / self.speeds[:, None]).max()) / 1000)

    def _workspace(self, home: Sequence[float]) -> Box:
        """A box around home that the tool reaches pointing down, down to the floor if the arm gets there below home.

        Its faces grow one after the other as long as the tool reaches their corners and the centres of them and their
        edges: to at most 40 % of the arm's length ahead, 60 % across and 25 % upwards.
        """
        at = self.chain.forward(home).tool
        start, yaw, rest = np.array(at.position), atan2(at.x[1], at.x[0]), np.array(home)
        ahead, across, up = self.length * np.array([0.2, 0.3, 0.25])
        most = np.array([[-ahead, -across, min(0.0, 0.02 - start[2])], [ahead, across, up]])
        size = np.zeros((2, 3))
        for faces, fraction in product((((0, 2),), ((0, 1), (1, 1), (0, 0), (1, 0), (1, 2))), (0.2, 0.1, 0.05)):
            growing = [*faces]
            while growing:
                for side, axis in [*growing]:
                    larger = size.copy()
                    larger[side, axis] += fraction * most[side, axis]
                    reached = abs(larger[side, axis]) <= abs(most[side, axis]) + 1e-9
                    for sides in product((0.0, 1.0, 0.5), repeat=3):
                        if reached and sides[axis] == side:
                            x, y, z = (start + larger[0] + np.array(sides) * (larger[1] - larger[0])).tolist()
                            reached = self._reaches(self._solved(rest, (x, y, z), yaw, rest, 60), (x, y, z))
                    if reached and most[side, axis]:
                        size = larger
                    else:
                        growing.remove((side, axis))
        low, high = np.round(1000 * (start + size), 6)
        # to whole mm inwards, but not past home where a face did not grow
        low = np.minimum(np.ceil(low), np.floor(1000 * start - 0.01)) / 1000
        high = np.maximum(np.floor(high), np.ceil(1000 * start + 0.01)) / 1000
        (a, b, c), (d, e, f) = low.tolist(), high.tolist()
        return Box((a, b, c), (d, e, f))
