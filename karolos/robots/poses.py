"""Home pose and workspace of an arm, by kinematics and the shapes of its links, without an engine."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from math import acos, atan2, cos, pi, sin
from typing import NamedTuple

import numpy as np

from ..core import Array
from ..core.seeding import SeedTree
from ..simulation.geometry import Box, Orientations, Quaternion, Vector
from ..simulation.kinematics import Chain, Pose, Stride, downward
from ..simulation.urdf import Joint, about
from .control import POSTURE_GAIN
from .model import ArmModel

STARTS = 6
"""Number of random joint positions from which inverse kinematics starts to search a home pose, per yaw of the tool."""
TILTS = tuple((cos(way), sin(way)) for way in (0.0, pi / 3, 2 * pi / 3, pi, 4 * pi / 3, 5 * pi / 3))
"""Number of directions in which the tool is tilted to find its reachable places."""
LIMIT_DISTANCE = 0.1
"""Distance in rad from the limits of the joints that home and workspace keep."""
HOME_SPEED = 0.8
"""Fraction of the joints' speeds that a full action may take at home."""
SMALLEST_WORKSPACE = 0.04
"""Least edge of a workspace in m."""
GRID, NARROWEST = (7, 5, 5), 2
"""Places along each edge of a workspace at which the tool is turned, and least number of their distances in a part."""
RANDOM_POSES = 60
"""Number of random poses that the tool takes in a part."""
ENOUGH, MORE, BETTER, LEAST = 0.85, 1.1, 1.02, 0.05
"""Rooms: at which the search ends, by how much a later one must be better, by how much one with the gripper turned on
the flange, and below which it goes to other heights and to the sides: policies that learned at one height are worse at
half of it (UR3: picking .80, at the usual 1.00)."""
TURNLESS = 0.6
"""What a workspace is worth in which the tool cannot be turned, relative to one in which it can."""
CONFIGURATIONS, DIFFERENT = 3, 0.5
"""Number of different poses with the same tool that are compared, and smallest difference of a joint in rad."""
HOME_HEIGHT, HOME_SHARE = 0.2, 0.3
"""Height in m of the tool at home above the floor, as for the built-in arms, and as a share of a small arm's length."""
HEIGHTS = (1.0, 0.75, 0.5, 1.25)
"""Heights at which homes are searched, as shares of that."""
REACH = (0.2, 0.25, 0.2)
"""Largest size in m of a workspace from home ahead, across and upwards, as for the built-in arms."""
REACH_SHARE = (0.2, 0.3, 0.25)
"""The same as shares of the arm's length."""
CLEARANCE, ROOM = 0.01, 0.06
"""Smallest height in m of the links above the floor, and of links before the last three, which could touch objects."""
CONTROL_STEPS, PERIOD = 45, 1 / 24
"""Control steps in which the tool gets from home to any place of the workspace, and their seconds."""
ARRIVED = 3e-3
"""Largest distance in m of the tool from the place after them."""
APART, TOUCH = 0.005, 0.001
"""Smallest distance in m of links that may collide, in the workspace and where the tool is turned."""
ASIDE = 0.3
"""Distance in m of the first joint from the z axis of the base's frame from which on home is searched around it."""
FAR = 0.05
"""Distance in m of links with only one between them from which on they must stay apart."""


class Place(NamedTuple):
    """A home pose and the space around it."""

    room: float
    """Share of the largest workspace: 1 is all. It is halved if four steps from home lead out of the workspace, and
    again if the tool does not get down to the floor."""
    home: tuple[float, ...]
    """Joint positions in rad."""
    tool: Vector
    """Position of the tool at home in m."""
    tool_step: float
    """Distance in m that the tool can move per control step along every axis."""
    workspace: Box
    corners: tuple[tuple[float, ...], ...]
    """Joint positions (n,) in rad at home and at the corners of the workspace."""
    dexterous: Box | None = None
    """The part of the workspace in which the tool can be turned, in m; None: there is none, or it was not searched."""

    @property
    def worth(self) -> float:
        """`room`, less if the tool cannot be turned in half of the workspace along each axis."""
        turned = 0.0
        if self.dexterous is not None:
            edges = (np.subtract(box.high, box.low) for box in (self.dexterous, self.workspace))
            turned = float(np.prod(np.minimum(2 * np.divide(*edges), 1.0)))
        return self.room * (TURNLESS + (1 - TURNLESS) * turned)


@dataclass(frozen=True)
class Outline:
    """Shapes of an arm and its hand that limit its workspace.

    Attributes:
        shapes: for each joint, points (k, 3) that span the parts it moves, in the frame of its link.
        fingers: the same of the fingers, in the frame of the last link.
        base: the same of the base, in its frame.
        lowest: height in m of the tool above the floor at which the hand meets it.
        closing: direction in the tool's frame along which fingers close; None without fingers.
    """

    shapes: tuple[Array, ...]
    fingers: Array
    base: Array
    lowest: float
    closing: tuple[float, float] | None = None

    @property
    def yaws(self) -> tuple[float, ...]:
        """Yaws of a tool that points down. Fingers close along the y axis, as on the built-in arms."""
        if self.closing is None:
            return 0.0, pi / 2, pi, 3 * pi / 2
        yaw = atan2(-self.closing[0], self.closing[1])
        return yaw, yaw + pi


class Poses:
    """An arm with its tool.

    Args:
        joints: from base to wrist.
        tool: translation in m and rotation (3, 3) of the tool in the frame of the last link.
        body: its shapes and its hand.
        usual_step: distance in m that the tool shall move per control step.
        floor: its height in m in the frame of the base. All places are above it.
    """

    def __init__(
        self, joints: Sequence[Joint], tool: tuple[Array, Array], body: Outline, usual_step: float, floor: float = 0.0
    ) -> None:
        self.chain, self.body, self.usual_step = Chain(joints, tool, (0.0, 0.0, -floor)), body, usual_step
        *others, hand = body.shapes
        self._shapes = [*others, np.vstack([hand, body.fingers])]
        self._latest: tuple[tuple[float, ...], list[Array]] = (), []
        """Joint positions and the points of the links there: most poses are looked at twice."""
        self._joints = [(np.array(one.origin), np.array(one.rotation), one.axis) for one in joints]
        self.length = sum(float(np.linalg.norm(one.origin)) for one in joints[1:]) + float(np.linalg.norm(tool[0]))
        """Length of the arm from its second joint to the tool, in m."""
        low, high = (np.array([getattr(joint, end) for joint in joints]) for end in ("lower", "upper"))
        turns = high - low > 2 * pi
        low, high = np.where(turns, np.maximum(low, -pi), low), np.where(turns, np.minimum(high, pi), high)
        distance = np.minimum(LIMIT_DISTANCE, (high - low) / 10)
        self.low, self.high = low + distance, high - distance
        inside = (low < -(high - low) / 10) & (high > (high - low) / 10)
        self.rest = np.where(inside, 0.0, (low + high) / 2)
        """Preferred joint positions: 0, or the middle of the range if 0 is near its end or outside."""
        self.speeds = np.array([joint.velocity for joint in joints])
        first = np.array(joints[0].origin[:2])
        self.middle: Array = first if np.linalg.norm(first) > ASIDE else np.zeros(2)
        """Place (2,) in m around which home is searched."""

    def best(self) -> Place | None:
        """The home pose whose `Place.worth` is largest; None if the tool cannot point down anywhere around the base.

        The search begins in front of the base, at the height and distance of the built-in arms. It goes on at other
        distances, and only if there is hardly room at other heights and then to the sides.
        """
        height = min(HOME_HEIGHT, HOME_SHARE * self.length)
        lifts = [max(share * height, self.body.lowest + 0.03) for share in HEIGHTS]
        away = dict.fromkeys([min(0.5, 0.55 * self.length), *(self.length * np.array([0.55, 0.45, 0.65, 0.35]))])
        best: Place | None = None
        for direction, lift, distance in product((0.0, -pi / 2, pi / 2, pi), lifts, away):
            first = direction == 0 and lift == lifts[0]
            if best is not None and (best.worth > ENOUGH if first else best.room > LEAST):
                break
            x, y = (self.middle + distance * np.array([cos(direction), sin(direction)])).tolist()
            for found in self._at((x, y, lift)):
                least = MORE * best.worth if best else 0.0
                if found.room > least:
                    turned = found._replace(dexterous=self._dexterous(found))
                    best = turned if turned.worth > least else best
        return best

    @property
    def shoulder(self) -> float:
        """Height in m of the second joint above the floor."""
        return float(self.chain.forward(self.rest.tolist()).axes[8])

    def off_vertical(self, pose: Sequence[float]) -> float:
        """Angle in rad between the direction of approach and the direction down."""
        return acos(min(max(-self.chain.forward(pose).tool.z[2], -1.0), 1.0))

    def at(self, home: Sequence[float], workspace: Box | None = None) -> Place:
        """The place of a known home pose, with its workspace if that is known, too."""
        found = self._around(tuple(home), workspace)
        return found._replace(dexterous=self._dexterous(found))

    def _at(self, target: Vector) -> Iterator[Place]:
        """Places whose home has the tool at `target`, pointing down: the best poses that inverse kinematics finds.

        They are far from joint limits, fast in every direction and near the preferred one, with links above the floor.
        """
        draws = SeedTree(0).generator()
        found: list[tuple[float, list[float], float]] = []

        def look(start: Array, yaw: float) -> None:
            pose = self._led(start, downward(target, yaw), self.rest, 60)
            if self._reaches(pose, target):
                distance = float(np.minimum(pose - self.low, self.high - pose).min())
                elbow = max(self.chain.forward(pose.tolist()).axes[2::6]) / self.length
                bent = float(np.abs(pose - self.rest).sum())
                fast = 12 * min(self._tool_step(pose), 2 * self.usual_step)
                found.append((min(distance, 0.5) + fast + 0.5 * elbow - 0.1 * bent, pose.tolist(), yaw))

        for yaw, start in product(self.body.yaws, range(STARTS)):
            look(self.rest + (1.0 if start % 2 else 0.3) * (draws.uniform(self.low, self.high) - self.rest), yaw)
        for yaw in self.body.yaws if found else ():  # a redundant arm may be straighter with the tool turned
            look(np.array(max(found)[1]), yaw)
        homes: list[Array] = []
        for _, pose, yaw in sorted(found, reverse=True):
            if all(np.abs(np.subtract(pose, other))[:-1].max() > DIFFERENT for other in homes):
                homes.append(self._led(np.array(pose), downward(target, yaw), self.rest, 500))
        for home in homes[:CONFIGURATIONS]:
            yield self._around(tuple(round(float(one), 4) + 0.0 for one in home), None)

    def _around(self, home: tuple[float, ...], workspace: Box | None) -> Place:
        step, box = min(self._tool_step(np.array(home)), self.usual_step), workspace or self._workspace(home)
        tool, edges = self.chain.forward(home).tool.position, np.subtract(box.high, box.low)
        free = min(np.subtract(tool, box.low).min(), np.subtract(box.high, tool).min()) > 4 * step
        down = box.low[2] < max(self.body.lowest, 0.0) + CLEARANCE
        most = np.diff(self._largest(np.array(tool)), axis=0)[0]
        room = float(np.prod(np.minimum(edges / most, 1.0))) * 0.5 ** ((not free) + (not down))
        stride = self._stride(home)
        corners = [self._walked(home, stride, place)[0] for place in product(*zip(box.low, box.high, strict=True))]
        poses = (home, *(tuple(pose.tolist()) for pose in corners))
        return Place(room if edges.min() >= SMALLEST_WORKSPACE else 0.0, home, tool, step, box, poses)

    def _dexterous(self, place: Place) -> Box | None:
        """The largest part of the workspace in which the tool can be turned as an `ArmModel` says by default.

        Its corners are places of a grid. At each place between them the tool takes turns and tilts at the limits, and
        it takes random poses of the part. Links that can collide stay apart. None if all such parts are too small.
        """
        around = Orientations(self.chain.forward(place.home).tool.orientation, ArmModel.tilt, ArmModel.turn)
        limits = [
            around.at(around.tilt * x, around.tilt * y, turn)
            for (x, y), turn in product(TILTS, (-around.turn, around.turn))
        ]
        pairs = self.pairs(place.corners)
        if not self._turns(place, pairs, [(place.tool, turn) for turn in limits]):
            return None
        low, high = (np.array(end) for end in (place.workspace.low, place.workspace.high))
        shares = [np.linspace(0.05, 0.95, count) for count in GRID]
        axes = [np.round(a + share * (b - a), 3).tolist() for a, b, share in zip(low, high, shares, strict=True)]
        takes = [self._turns(place, pairs, [(at, turn) for turn in limits]) for at in product(*axes)]
        free = np.array(takes).reshape(GRID)
        sides = [[side for side in combinations(range(count), 2) if side[1] - side[0] >= NARROWEST] for count in GRID]
        parts = [part for part in product(*sides) if free[tuple(slice(a, b + 1) for a, b in part)].all()]
        draws = SeedTree(0).generator()
        for part in sorted(parts, key=lambda part: -float(np.prod(np.diff(part) / np.subtract(GRID, 1)[:, None]))):
            (a, b, c), (d, e, f) = (
                [axis[k] for axis, k in zip(axes, end, strict=True)] for end in zip(*part, strict=True)
            )
            directions = draws.uniform(-pi, pi, RANDOM_POSES)
            turns = draws.uniform(-around.turn, around.turn, RANDOM_POSES)
            poses = [
                (
                    draws.uniform((a, b, c), (d, e, f)).tolist(),
                    around.at(around.tilt * cos(way), around.tilt * sin(way), turn),
                )
                for way, turn in zip(directions, turns, strict=True)
            ]
            if self._turns(place, pairs, poses):
                return Box((a, b, c), (d, e, f))
        return None

    def _turns(
        self, place: Place, pairs: Sequence[tuple[int, int]], poses: Iterable[tuple[Vector, Quaternion]]
    ) -> bool:
        """Whether inverse kinematics from home brings the tool into each of these poses, with these links apart."""
        home = np.array(place.home)
        for at, turn in poses:
            goal = Pose.at(at, turn)
            pose = self._led(home, goal, home, 60)
            if not (self._takes(pose, goal) and self._apart(pose.tolist(), pairs, TOUCH) == pairs):
                return False
        return True

    def _links(self, pose: Sequence[float]) -> list[Array]:
        """Points (k, 3) of each link in m: the last one with its fingers, then the base."""
        latest, links = self._latest
        if latest != tuple(pose):
            place, turn, links = self.chain.base, np.eye(3), []
            for (origin, rotation, axis), position, points in zip(self._joints, pose, self._shapes, strict=True):
                place, turn = place + turn @ origin, turn @ rotation @ about(axis, position)
                links.append(place + points @ turn.T)
            links.append(self.body.base + self.chain.base)
            self._latest = tuple(pose), links
        return links

    def pairs(self, poses: Iterable[Sequence[float]]) -> list[tuple[int, int]]:
        """Pairs of links that are apart in all of these poses, and can collide elsewhere; -1 is the base.

        One link is among the last three, and the two are not neighbours. Shapes larger than the links always touch.

        Args:
            poses: joint positions in rad, (n,) each.
        """
        last = len(self._joints) - 1
        found = [(one, other) for other in range(last - 2, last + 1) for one in range(-1, other - 1)]
        for pose in poses:
            found = self._apart(pose, found)
        return found

    def _apart(
        self, pose: Sequence[float], pairs: Sequence[tuple[int, int]], distance: float = APART
    ) -> list[tuple[int, int]]:
        """Those of some pairs of links that are further apart than a distance in m in a pose."""
        links = self._links(pose)
        middles = [points.mean(0) if len(points) else None for points in links]
        return [(a, b) for a, b in pairs if _apart((links[a], middles[a]), (links[b], middles[b]), distance)]

    def _led(self, pose: Array, target: Pose, rest: Array, steps: int) -> Array:
        """A pose (n,) near this one with the tool there, if inverse kinematics finds one."""
        return self.chain.led(pose.tolist(), target, (self.low, self.high), (rest.tolist(), POSTURE_GAIN), steps)

    def _walked(self, home: Sequence[float], stride: Stride, target: Sequence[float]) -> tuple[Array, bool]:
        """The pose (n,) to which full actions of cartesian control lead the tool from home, and whether it is there."""
        pose = self.chain.walked(home, target, (self.low, self.high), stride, CONTROL_STEPS)
        end = self.chain.forward(pose.tolist()).tool
        there = float(np.linalg.norm(np.subtract(end.position, target))) < ARRIVED and end.z[2] < -1 + 1e-4
        return pose, there and self._clear(pose)

    def _stride(self, home: Sequence[float]) -> Stride:
        """A full action of cartesian control. A slow arm needs several for the same way: they count as one here."""
        slower = self.usual_step / max(self._tool_step(np.array(home)), 1e-3)
        return Stride(self.usual_step, self.speeds * PERIOD * max(1.0, slower), POSTURE_GAIN)

    def _clear(self, pose: Array) -> bool:
        """Whether all links except the first are above the floor, and those before the last three above objects on it.

        Objects are beyond half of the way from the base to the tool.
        """
        *links, hand, _ = self._links(pose.tolist())
        links.append(hand[: len(self.body.shapes[-1])])  # fingers may touch the floor
        if min(points[:, 2].min(initial=np.inf) for points in links[1:]) < CLEARANCE:
            return False
        x, y = np.array(self.chain.forward(pose.tolist()).tool.position[:2]) - self.middle
        inner = np.vstack(links[1:-3])
        beyond = (inner[:, :2] - self.middle) @ (x, y) > (x * x + y * y) / 2
        return bool((inner[beyond, 2] > ROOM).all())

    def _reaches(self, pose: Array, target: Vector) -> bool:
        """Whether the tool is at `target` and points down, with all links above the floor."""
        at = self.chain.forward(pose.tolist())
        off = float(np.linalg.norm(np.subtract(at.tool.position, target)))
        return off < 1e-3 and at.tool.z[2] < -1 + 1e-5 and self._clear(pose)

    def _takes(self, pose: Array, target: Pose) -> bool:
        """Whether the tool has this position and orientation, with all links above the floor."""
        at = self.chain.forward(pose.tolist())
        off = (float(np.linalg.norm(np.subtract(*pair))) for pair in zip(at.tool, target, strict=True))
        return max(off) < 2e-3 and self._clear(pose)

    def _tool_step(self, home: Array) -> float:
        """The distance in m that the tool can move per control step along every axis from home."""
        inverse = np.abs(np.linalg.pinv(self.chain.jacobian(self.chain.forward(home.tolist())))[:, :3])
        return float(np.floor(1000 * HOME_SPEED * PERIOD / (inverse / self.speeds[:, None]).max()) / 1000)

    def _largest(self, start: Array) -> Array:
        """The faces (2, 3) of the largest workspace around a tool, relative to it."""
        ahead, across, up = np.minimum(REACH, self.length * np.array(REACH_SHARE))
        return np.array([[-ahead, -across, min(0.0, self.body.lowest - start[2])], [ahead, across, up]])

    def _workspace(self, home: Sequence[float]) -> Box:
        """A box around home that actions reach with the tool, down to the floor if the arm gets there below home.

        No link that is apart from another at home touches it there. Links with only one between them are built close
        together, and count only if they are far apart at home. The faces of the box grow one after the other as long
        as actions bring the tool to their corners and the centres of them and their edges.
        """
        start, pairs = np.array(self.chain.forward(home).tool.position), self.pairs([home])
        far = self._apart(home, pairs, FAR)
        pairs = [(one, other) for one, other in pairs if other - one > 2 or (one, other) in far]
        most, stride = self._largest(start), self._stride(home)
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
                            place = start + larger[0] + np.array(sides) * (larger[1] - larger[0])
                            pose, reached = self._walked(home, stride, place.tolist())
                            reached = reached and self._apart(pose.tolist(), pairs) == pairs
                    if reached and most[side, axis]:
                        size = larger
                    else:
                        growing.remove((side, axis))
        # to whole mm inwards, but 1 mm beyond home where a face did not grow
        low = np.minimum(np.ceil(np.round(1000 * (start + size[0]), 6)), np.floor(1000 * start) - 1) / 1000
        high = np.maximum(np.floor(np.round(1000 * (start + size[1]), 6)), np.ceil(1000 * start) + 1) / 1000
        (a, b, c), (d, e, f) = low.tolist(), high.tolist()
        return Box((a, b, c), (d, e, f))


def _rays(count: int) -> Array:
    """Directions (count, 3), evenly over the sphere (Fibonacci's spiral)."""
    heights = 1 - (2 * np.arange(count) + 1) / count
    angles, radii = pi * (3 - 5**0.5) * np.arange(count), np.sqrt(1 - heights**2)
    return np.column_stack([radii * np.cos(angles), radii * np.sin(angles), heights])


RAYS = _rays(100)


def spanning(points: Array) -> Array:
    """Those of the points (k, 3) that lie furthest in some directions."""
    found: Array = points[np.unique((points @ RAYS.T).argmax(0))] if len(points) else points
    return found


def _apart(first: tuple[Array, Array | None], second: tuple[Array, Array | None], distance: float = APART) -> bool:
    """Whether the convex hulls of two sets of points are further apart than a distance in m; never for an empty set.

    A set comes with the mean of its points; None: it is empty.

    The algorithm of Gilbert, Johnson and Keerthi (IEEE Journal on Robotics and Automation 4, 1988): the point of the
    hulls' difference that is nearest to 0, from at most four of its corners. Each direction shows a plane between them.
    """
    (one, middle), (other, end) = first, second
    if middle is None or end is None:
        return False
    way, corners = end - middle, np.zeros((0, 3))
    for _ in range(30):
        nearer = other[(other @ way).argmin()] - one[(one @ way).argmax()]
        length = float(np.linalg.norm(way))
        if float(way @ nearer) > distance * length:
            return True
        if len(corners) and (length <= distance or float(way @ (way - nearer)) < 1e-8):
            return False
        way, corners = _nearest(np.vstack([corners, nearer]))
    return False


def _nearest(corners: Array) -> tuple[Array, Array]:
    """The point (3,) nearest to 0 of the hull of at most five points, and those of them (k, 3) that span its face."""
    found: list[tuple[float, Array, Array]] = []
    for number in range(1, min(len(corners), 4) + 1):
        for face in combinations(corners, number):
            points = np.array(face)
            sums = np.ones((number + 1, number + 1))
            sums[:-1, :-1], sums[-1, -1] = points @ points.T, 0.0
            weights = np.linalg.lstsq(sums, np.eye(number + 1)[-1], rcond=None)[0][:-1]
            if (weights > -1e-12).all():
                point = weights @ points
                found.append((float(point @ point), point, points))
    _, point, points = min(found, key=lambda one: one[0])
    return point, points
