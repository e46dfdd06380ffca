"""The free flight of a cube, and plans of throws by kinematics."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from math import atan2, cos, hypot, pi, sin
from typing import NamedTuple

import numpy as np

from ..core import Array
from ..errors import UsageError
from ..simulation.geometry import Vector
from ..simulation.interface import GRAVITY, RobotView

LONGEST_FLIGHT = 3.0
"""Longest flight in s; no robot throws higher than for 2 s."""
FLIGHT_STEPS = 100
"""Number of steps in which the contact with the floor is searched along a whole flight."""


def flight_time(height: Array | float, rise: Array | float, gravity: float) -> Array:
    """Seconds (...) until free fall from `height` (...) m at `rise` (...) m/s upwards reaches height 0.

    The larger root of height + rise t + gravity t^2 / 2 = 0, gravity in m/s2 along z; at most `LONGEST_FLIGHT`, and 0
    for a height below 0.
    """
    gravity = min(gravity, -1e-6)  # without gravity only a sinking body comes down
    above = np.maximum(height, 0.0)
    seconds = (rise + np.sqrt(rise * rise - 2 * gravity * above)) / -gravity
    return np.where(above > 0, np.minimum(seconds, LONGEST_FLIGHT), 0.0)


class Flight(NamedTuple):
    """A cube in free flight."""

    position: Vector
    velocity: Vector
    axes: tuple[Vector, Vector, Vector]
    """Unit vectors along its edges."""
    angular_velocity: Vector
    """Angular velocity in rad/s. It is constant: a cube's inertia is the same about every axis."""
    half: float
    """Half an edge in m."""
    gravity: float
    """Gravity in m/s2 along z; negative pulls down."""

    def lowest(self, seconds: float) -> float:
        """Height of the lowest corner above the floor after that time, in m."""
        x, y, z = self.angular_velocity
        rate = (x * x + y * y + z * z) ** 0.5
        upright = 0.0
        if rate < 1e-9:
            upright = sum(abs(axis[2]) for axis in self.axes)
        else:
            x, y, z = x / rate, y / rate, z / rate
            k, s = cos(rate * seconds), sin(rate * seconds)
            for a, b, c in self.axes:  # height of a rotated axis (Rodrigues)
                upright += abs(c * k + (x * b - y * a) * s + z * (x * a + y * b + z * c) * (1 - k))
        height = self.position[2] + self.velocity[2] * seconds + 0.5 * self.gravity * seconds * seconds
        return height - self.half * upright

    def landing(self, within: float, *, steps: int = 10) -> tuple[float, float] | None:
        """Position of the centre (x, y) in m when a corner first touches the floor, or None if not `within` seconds.

        The time is exact to 1 % of `within / steps` seconds.
        """
        before = 0.0
        for step in range(1, steps + 1):
            after = within * step / steps
            if self.lowest(after) <= 0:
                break
            before = after
        else:
            return None
        for _ in range(7):
            middle = (before + after) / 2
            before, after = (before, middle) if self.lowest(middle) <= 0 else (middle, after)
        return self.position[0] + self.velocity[0] * after, self.position[1] + self.velocity[1] * after


RUN_UP = 0.4
"""Seconds at constant speed before the release, in which the arm accelerates to that speed."""
FOLLOW_THROUGH = 0.15
"""Seconds at constant speed after the release, in which the gripper opens and the arm brakes."""
AT_FULL_SPEED = (-0.2, -0.1, 0.0, 0.06)
"""Times in s from the release at which the tool's speed is checked: earlier the arm accelerates, later it brakes."""
PLANNED_TOOL_SPEED = 0.92
"""Fraction of the tool's largest speed that a plan uses. The rest is for corrections."""
FLOOR_CLEARANCE = 0.12
"""Smallest height in m of the tool and of the swinging joints above the floor."""
BASE_CLEARANCE = 0.2
"""Smallest distance in m of the tool from the axis of the base joint while it is lower than .2 m above the first
swinging joint, because the arm's base is there."""
UNFOLDED_SHARE = 0.4
"""Smallest distance of the tool from the first swinging joint as a fraction of the largest, so that the hand does not
touch the upper arm."""
GRID_POINTS = 9
"""Number of points of the search along each joint. The grid then shrinks around the best point."""
GRID_ROUNDS = 5
FIRST_THROWS, NEXT_THROWS, KEPT_THROWS, SEARCH_ROUNDS = 3000, 300, 30, 16
"""Search for the furthest throw: number of first throws, throws per round, kept throws, and rounds."""
SLOWEST_SHARE = 0.3
"""Slowest throw as a fraction of the full speed."""


class ThrowPlan(NamedTuple):
    """The motion for one target; all joints of the arm, in rad and rad/s."""

    release: tuple[float, ...]
    """Joint positions at which the object leaves."""
    velocities: tuple[float, ...]
    """Joint velocities during the whole throw."""


def landing_distance(position: Array, velocity: Array, height: float) -> Array:
    """Horizontal position in m at which free fall from `position` reaches `height`.

    Complex numbers: the real part is horizontal, the imaginary part the height; m and m/s. There is no air drag.
    """
    seconds = flight_time(position.imag - height, velocity.imag, GRAVITY)
    distance: Array = position.real + velocity.real * seconds
    return distance


class ThrowPlanner:
    """Plans throws by kinematics: the furthest throw of a robot, and from it the throw at any nearer target.

    A throw turns the joints whose axes are horizontal and parallel ("swinging joints"), so that the tool moves in one
    vertical plane. Each joint turns at a constant speed within its limit, and the tool stays within its own limit. The
    base joint turns that plane towards the target. The release is at the maximum of the landing distance along the
    motion: there an early or late opening matters least. Slower motions throw less far.

    Args:
        height: of the object's centre above the floor when it has landed, in m.

    Attributes:
        axis: x and y of the robot's axis, that of the base joint, in m.
        reach: the largest horizontal distance of the tool from the robot's axis, in m.
        furthest: the largest landing distance from that axis, in m.

    Raises UsageError if no joint turns a vertical plane with two swinging joints in it, or actions do not turn joints.
    """

    def __init__(self, robot: RobotView, height: float) -> None:
        if not robot.turns_joints:
            raise UsageError(
                "cartesian control keeps the gripper pointing down and within the workspace, and no throw from there "
                "lands beyond the arm's reach",
                setting="robot.control",
                hint="set robot.control: joint, which throws with the speed of every joint",
            )
        self._robot = robot
        self._height = height
        self._find_joints()
        limits = robot.limits
        self._home = np.array(robot.home_joints)
        speed = np.minimum(limits.velocity, np.array(robot.joint_step) / robot.period)
        # a joint that can make several turns is used from -pi to pi
        self._low = low = np.maximum(limits.lower, self._home - pi)[self._swinging]
        self._high = high = np.minimum(limits.upper, self._home + pi)[self._swinging]
        self._speed = speed[self._swinging]
        self._tool_speed = PLANNED_TOOL_SPEED * robot.tool_speed
        planar = self._search(lambda positions: self._points(positions)[:, -1].real, low, high)[1]
        self._span = self._search(lambda positions: abs(self._points(positions)[:, -1] - self._first), low, high)[1]
        self.reach = hypot(planar, self._offset)
        self._release, self._velocities = self._search_throw()
        # landing distance and time of release of slower throws
        self._speeds = np.linspace(SLOWEST_SHARE, 1.0, 71)
        times = np.linspace(-RUN_UP / 2, 0.0, 46)
        distances = np.stack([self._distances(speed, times) for speed in self._speeds])
        self._release_times = times[distances.argmax(1)]
        self._landings = np.maximum.accumulate(distances.max(1))
        self.furthest = hypot(float(self._landings[-1]), self._offset)

    def _find_joints(self) -> None:
        """Find the base joint, the swinging joints and the wrist from their axes at the home pose."""
        robot = self._robot
        home = robot.forward(robot.home_joints)
        joints = np.array(home.axes).reshape(-1, 6)
        origins, axes = joints[:, :3], joints[:, 3:]
        vertical = np.flatnonzero(np.abs(axes[:, 2]) > 0.999)
        horizontal = np.flatnonzero(np.abs(axes[:, 2]) < 0.001)
        if vertical.size and horizontal.size:
            normal = axes[horizontal[0]]
            ahead = np.cross((0.0, 0.0, 1.0), normal)  # turning about the normal lifts everything ahead
            self._base = int(vertical[0])
            x, y = origins[self._base, :2].tolist()
            self.axis = x, y
            tool = np.array(home.tool.position)
            if (tool[:2] - self.axis) @ ahead[:2] < 0:
                normal, ahead = -normal, -ahead
            self._swinging = horizontal[np.abs(axes[horizontal] @ normal) > 0.999]
        if not (vertical.size and horizontal.size and vertical[0] < horizontal[0] and self._swinging.size >= 2):
            raise UsageError(
                "no throw can be planned for this arm: at the home pose no joint turns about the vertical with two "
                "horizontal, parallel joints after it",
                setting="robot",
                hint="choose another robot, or another task",
            )
        self._base_sign = float(np.sign(axes[self._base, 2]))
        self._signs = axes[self._swinging] @ normal
        points = np.vstack([origins[self._swinging], tool])
        planar = (points[:, :2] - self.axis) @ ahead[:2] + 1j * points[:, 2]
        self._first, self._segments = planar[0], np.diff(planar)
        self._offset = float((tool[:2] - self.axis) @ normal[:2])
        """Distance in m of the plane from the axis of the base joint."""
        self._azimuth = atan2(ahead[1], ahead[0])
        # the pads face along the tool's y axis: a wrist turns them to face across the plane, out of the object's way
        self._wrist = int(vertical[-1]) if vertical[-1] > self._swinging[-1] else None
        y = home.tool.y
        error = atan2(normal[0] * y[1] - normal[1] * y[0], normal[0] * y[0] + normal[1] * y[1])
        error = (error + pi / 2) % pi - pi / 2  # either pad may be on either side
        self._wrist_turn = -error * float(np.sign(axes[self._wrist, 2])) if self._wrist is not None else 0.0

    def _points(self, positions: Array) -> Array:
        """(..., k + 1) complex: the swinging joints and the tool in their plane, at joint positions (..., k)."""
        angles = np.cumsum((positions - self._home[self._swinging]) * self._signs, -1)
        segments = self._segments * np.exp(1j * angles)
        first = np.broadcast_to(self._first, (*segments.shape[:-1], 1))
        return np.concatenate([first, self._first + np.cumsum(segments, -1)], -1)

    def _velocity(self, points: Array, velocities: Array) -> Array:
        """(...) complex: velocity of the tool in m/s at joint velocities (..., k)."""
        tool = points[..., -1:]
        velocity: Array = (1j * (tool - points[..., :-1]) * velocities * self._signs).sum(-1)
        return velocity

    def _search(self, objective: Callable[[Array], Array], low: Array, high: Array) -> tuple[Array, float]:
        """Joint positions (k,) of the maximum of `objective` between `low` and `high`, and the maximum.

        A grid search that shrinks around the best point.
        """
        best, maximum = (low + high) / 2, -np.inf
        begin, end = low, high
        for _ in range(GRID_ROUNDS):
            axes = [np.linspace(a, b, GRID_POINTS) for a, b in zip(begin, end, strict=True)]
            grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, low.size)
            values = objective(grid)
            index = int(values.argmax())
            if values[index] > maximum:
                best, maximum = grid[index], float(values[index])
            step = (end - begin) / (GRID_POINTS - 1)
            begin, end = np.maximum(best - 1.5 * step, low), np.minimum(best + 1.5 * step, high)
        return best, maximum

    def _search_throw(self) -> tuple[Array, Array]:
        """Joint positions at the release and joint velocities of the furthest throw.

        A search by the cross-entropy method (Rubinstein 1999), once for each combination of the joints' directions.
        """
        draws, best = np.random.Generator(np.random.PCG64(0)), None
        for signs in product((-1.0, 1.0), repeat=self._swinging.size):
            low, high = np.minimum(signs, 0.0), np.maximum(signs, 0.0)
            shares = np.clip(draws.uniform(1.6 * low, 1.6 * high, (FIRST_THROWS, low.size)), low, high)
            # the joints have room there for that speed, or for a fraction of it
            slowed = self._speed * shares * draws.uniform(0.0, 1.0, (FIRST_THROWS, 1))
            begin = self._low + np.maximum(slowed * RUN_UP, np.maximum(-slowed * FOLLOW_THROUGH, 0.0))
            end = self._high + np.minimum(slowed * RUN_UP, np.minimum(-slowed * FOLLOW_THROUGH, 0.0))
            positions = begin + draws.uniform(0.0, 1.0, begin.shape) * (end - begin)
            for _ in range(SEARCH_ROUNDS):
                velocities = self._within_tool_speed(positions, self._speed * shares)
                distances = self._landing_if_possible(positions, velocities)
                kept = np.argsort(-distances)[:KEPT_THROWS]
                kept = kept[np.isfinite(distances[kept])]
                if not kept.size:
                    break
                if best is None or distances[kept[0]] > best[0]:
                    best = float(distances[kept[0]]), positions[kept[0]], velocities[kept[0]]
                positions, shares = (
                    draws.normal(one[kept].mean(0), one[kept].std(0) + 1e-3, (NEXT_THROWS, low.size))
                    for one in (positions, shares)
                )
                positions, shares = np.clip(positions, self._low, self._high), np.clip(shares, low, high)
        if best is None:
            raise UsageError("this arm has no room to swing", setting="robot", hint="choose another robot")
        return best[1], best[2]

    def _within_tool_speed(self, release: Array, velocities: Array) -> Array:
        """Joint velocities (m, k), reduced if the tool would be too fast in the throw."""
        for _ in range(2 if np.isfinite(self._tool_speed) else 0):  # at a lower speed the arm is elsewhere
            ways = release[:, None] + np.multiply.outer(np.array(AT_FULL_SPEED), velocities).swapaxes(0, 1)
            speeds = np.abs(self._velocity(self._points(ways), velocities[:, None]))
            velocities = velocities * np.minimum(1.0, self._tool_speed / np.maximum(speeds.max(1), 1e-9))[:, None]
        return velocities

    def _landing_if_possible(self, release: Array, velocities: Array) -> Array:
        """Landing distances (m,) of throws (m, k); -inf if joints leave their range or something is in the way."""
        begin, end = release - velocities * RUN_UP, release + velocities * FOLLOW_THROUGH
        possible = ((np.minimum(begin, end) >= self._low) & (np.maximum(begin, end) <= self._high)).all(1)
        possible[possible] = self._collision_free(release[possible], velocities[possible])
        points = self._points(release)
        distances = landing_distance(points[:, -1], self._velocity(points, velocities), self._height)
        return np.where(possible, distances, -np.inf)

    def _collision_free(self, release: Array, velocities: Array) -> Array:
        """Whether throws (m, k) touch neither floor nor arm, including the way to their start."""
        start, home = release - velocities * RUN_UP, self._home[self._swinging]
        middle, end = release - velocities * RUN_UP / 2, release + velocities * FOLLOW_THROUGH
        free = np.ones(len(release), np.bool_)
        for positions in (start, (2 * start + home) / 3, middle, release, end):
            points = self._points(positions)
            tool = points[:, -1]
            free &= (points[:, 1:].imag > FLOOR_CLEARANCE).all(1)
            free &= (tool.real > BASE_CLEARANCE) | (tool.imag > self._first.imag + BASE_CLEARANCE)
            free &= abs(tool - self._first) > UNFOLDED_SHARE * self._span
        return free

    def _distances(self, speed: float, times: Array) -> Array:
        """Landing distances for releases at `times` in s along a throw at this fraction of the full speed."""
        velocities = self._velocities * speed
        points = self._points(self._release + np.multiply.outer(times, velocities))
        return landing_distance(points[:, -1], self._velocity(points, velocities), self._height)

    def plan(self, x: float, y: float) -> ThrowPlan:
        """The throw that lands at x, y in m, or as near as possible to a target out of range."""
        distance = self.distance_along(x, y)
        speed = float(np.interp(distance, self._landings, self._speeds))
        time = float(np.interp(speed, self._speeds, self._release_times))
        release, velocities = self._home.copy(), np.zeros_like(self._home)
        velocities[self._swinging] = self._velocities * speed
        release[self._swinging] = self._release + time * self._velocities * speed
        turn = atan2(y - self.axis[1], x - self.axis[0]) - self._azimuth + atan2(self._offset, distance)
        release[self._base] += atan2(sin(turn), cos(turn)) * self._base_sign
        if self._wrist is not None:
            release[self._wrist] += self._wrist_turn
        return ThrowPlan(tuple(release.tolist()), tuple(velocities.tolist()))

    def distance_along(self, x: float, y: float) -> float:
        """Distance in m of x, y from the robot's axis along the plane of a throw that passes over it."""
        distance = hypot(x - self.axis[0], y - self.axis[1])
        return float(max(distance * distance - self._offset**2, 0.0) ** 0.5)

    def landing_of(self, positions: Array, velocities: Array) -> Array:
        """Landing distance in m along the plane of the throw, released at joint positions and velocities (..., n)."""
        points = self._points(positions[..., self._swinging])
        return landing_distance(points[..., -1], self._velocity(points, velocities[..., self._swinging]), self._height)
