"""Throw: the arm throws a cube at a target on the floor that it cannot reach.

The task, the ballistics of the cube, the planner of throws and the expert that executes a plan.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product
from math import atan2, cos, degrees, hypot, pi, radians, sin, sqrt
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field as Setting

from ..core import Array, BoolArray, Field, FloatArray, GoalRule, Layout
from ..core.seeding import Generator
from ..errors import UsageError
from ..randomization.randomization import RandomizedParameter
from ..simulation.geometry import Vector
from ..simulation.interface import Box, Camera, Expert, RobotView, World
from ..simulation.interface.engine import GRAVITY
from .cube import FIELDS, CubeSettings, CubeTask, check_gripper
from .point_goal import GOAL_COLOUR, sample_position

LONGEST_FLIGHT = 3.0
"""Seconds that a flight is followed at the most; no robot throws higher than for 2."""
FLIGHT_STEPS = 100
"""Steps in which the floor is looked for along a whole flight."""
FLOOR_CONTACT = 0.002
"""m above the floor below which a corner of the cube counts as touching it."""
BOUNCE = 0.08
"""m above the floor: a control step after a landing no corner of the cube is higher."""


class Landing(GoalRule):
    """Success where a thrown object lands nearer than `threshold` to the target, in m; landing ends the episode.

    `achieved` (..., 3) is the object's position on the floor (2) in m and a status: 0 in the hand or in the air, 1
    landed after a release, -1 put on the floor without a release. `desired` (..., 2) is the target in m.

    Sparse reward: 1 for a success, else 0; a cost per step would make dropping the object at once profitable. Dense
    reward: 1 - tanh(2 d) for landing after a release, d in m from the target; else 0.
    """

    reward_range = (0.0, 1.0)

    def __init__(self, threshold: float, *, dense: bool) -> None:
        self.threshold = threshold
        self.dense = dense

    def distance(self, achieved: Array, desired: Array) -> FloatArray:
        difference = achieved[..., :2] - desired
        metres = np.sqrt(np.vecdot(difference, difference))
        landed: FloatArray = np.where(achieved[..., 2] > 0.5, metres, np.inf).astype(np.float32)
        return landed

    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        if self.dense:
            reward: FloatArray = (1 - np.tanh(2 * self.distance(achieved, desired))).astype(np.float32)
            return reward
        return self.success(achieved, desired).astype(np.float32)

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        near: BoolArray = self.distance(achieved, desired) < self.threshold
        return near

    def terminated(self, achieved: Array, desired: Array) -> BoolArray:  # noqa: ARG002 (wherever the target is)
        landed: BoolArray = np.abs(achieved[..., 2]) > 0.5
        return landed


class Throw(CubeTask):
    """What to do: throw the cube, which starts in the gripper, so that it comes down on the target.

    What is randomised: the tool's start, within `start_range` of the home position along each axis, and the target: on
    the floor in front of the robot within `sector` degrees to either side, beyond the arm's reach by at least
    `threshold` and nearer than `share` of the furthest throw.

    Observation: object_position (3, m), object_rotation (6, two columns of its matrix), object_velocity (3, m/s),
    object_angular_velocity (3, rad/s), object_from_tool (3, m), landing_if_released (2, m) and time_of_flight (1, s):
    where and when the centre of the cube would come down if it left the hand now, in free fall without spin.
    Action: the robot's joint changes and the gripper.
    Goals: achieved, the cube's position on the floor (2, m), after the landing that of its first contact, and a status
    (0 in hand or air, 1 landed after a release, -1 on the floor without one); desired, the target (2, m).
    Reward: at landing; sparse 1 within the threshold, else 0; dense in [0, 1], see `Landing`.
    What counts as success: the cube's first contact with the floor after its release lies within `threshold` of the
    target. Flying over the target or carrying the cube there does not count.
    Termination: when the cube touches the floor, thrown or put down; truncated after `max_steps`. With probability
    `end_at_release` already when the cube leaves the hand, at the landing that free flight computes; as a parameter of
    domain randomization in training alone. The computed landing is that of an undisturbed flight: a hand that touches
    the cube again moves the true one by up to a decimetre.

    Reach and furthest throw follow from the speed limits of the joints, see `ThrowPlanner`. Horizontal distances from
    the robot's axis: panda .95 and 2.13 m, ur5 1.06 and 2.39 m, iiwa 1.08 and 1.73 m. Such throws turn the gripper, so
    `control: joint` is needed, the default of the robots for this task: pointing down, within the workspace, no throw
    lands beyond .81 (panda), .86 (ur5) and .79 m (iiwa), within the arm's reach.
    """

    class Settings(CubeSettings):
        reward: Literal["sparse", "dense"] = Setting("sparse", description="at landing: 1 or 0, or by the distance")
        threshold: float = Setting(0.1, gt=0, le=0.5, description="distance at which the target is hit, m")
        share: float = Setting(0.85, gt=0, le=1, description="largest distance of a target / furthest throw")
        sector: float = Setting(30.0, gt=0, le=60, description="of targets, to either side of straight ahead, degrees")
        max_steps: int = Setting(75, ge=1, le=100_000, description="control steps per episode")
        start_range: float = Setting(0.05, ge=0, le=0.5, description="of the tool about home along each axis, m")
        end_at_release: float = Setting(
            0.0, ge=0, le=1, description="probability that an episode ends at the release, its landing computed"
        )

    settings: Throw.Settings
    observation = Layout((*FIELDS, Field("landing_if_released", 2, "m"), Field("time_of_flight", 1, "s")))
    uses_gripper = True
    points_down = False
    camera = Camera(target=(0.9, 0.0, 0.35), distance=4.3, yaw=22.0, pitch=-22.0)
    achieved_goal = Layout((Field("landing_point", 2, "m"), Field("landed", 1)))
    desired_goal = Layout((Field("target", 2, "m"),))

    def __init__(self, settings: Throw.Settings) -> None:
        self.settings = settings
        self.goal = np.zeros(2, np.float32)
        self.goal_rule = Landing(settings.threshold, dense=settings.reward == "dense")
        self._gravity = GRAVITY
        self._end_at_release = settings.end_at_release

    @property
    def parameters(self) -> Mapping[str, RandomizedParameter]:
        probability = RandomizedParameter(
            "1", self.settings.end_at_release, 0.0, 1.0, "probability that an episode ends at the release"
        )
        start = RandomizedParameter(
            "m", self.settings.start_range, 0.0, 0.5, "of the tool about home along each axis, within the workspace"
        )
        return {**super().parameters, "end_at_release": probability, "start_range": start}

    @property
    def max_steps(self) -> int:
        return self.settings.max_steps

    def fit(self, robot: RobotView) -> None:
        settings, self._robot = self.settings, robot
        check_gripper(robot, type(self).__name__, settings.object_size)
        self.planner = planner = ThrowPlanner(robot, settings.object_size / 2)
        self.nearest, self.furthest = planner.reach + settings.threshold, settings.share * planner.furthest
        if self.nearest >= self.furthest:
            raise UsageError(
                f"no target is left between {self.nearest:.2f} m, the arm's reach and the threshold, and "
                f"{self.furthest:.2f} m, {settings.share:g} of the furthest throw",
                where="task.share",
                hint="a larger share or robot.joint_step leaves more, a smaller task.threshold too",
            )
        self._starts = self._start_within(settings.start_range)
        angle, far = radians(settings.sector), self.furthest
        targets = Box((self.nearest * cos(angle), -far * sin(angle), 0.0), (far, far * sin(angle), 0.0))
        self._targets = targets.moved((*planner.axis, 0.0))

    def _start_within(self, metres: float) -> Box:
        """Where the tool starts: at most this far from home along each axis, within the workspace."""
        home, workspace = self._robot.home, self._robot.workspace
        ranges = [
            (max(at - metres, low), min(at + metres, high))
            for at, low, high in zip(home, workspace.low, workspace.high, strict=True)
        ]
        return Box(*zip(*ranges, strict=True))

    def build(self, world: World) -> None:
        super().build(world)
        world.release_in_motion()
        self._marker = world.marker(self.settings.threshold, GOAL_COLOUR)

    def apply(self, world: World, name: str, value: float) -> None:
        if name == "end_at_release":
            self._end_at_release = value
            return
        if name == "start_range":
            self._starts = self._start_within(value)
            return
        if name == "gravity":
            self._gravity = value
        super().apply(world, name, value)

    def reset(self, generator: Generator) -> None:
        x, y, z = sample_position(generator, self._starts, "the cube").tolist()
        self.cube.put_in_gripper(self._robot, (x, y, z))
        self._flight: Flight | None = None
        self._landing: tuple[float, float] | None = None
        self._status = 0.0
        target = sample_position(generator, self._targets, "the target", self._is_target)
        self.goal = target[:2].copy()
        self._marker.place((float(target[0]), float(target[1]), 0.0))
        self._ends_at_release = generator.uniform() < self._end_at_release

    def _is_target(self, position: FloatArray) -> bool:
        x, y = (at - axis for at, axis in zip(position.tolist(), self.planner.axis, strict=False))
        return self.nearest <= hypot(x, y) <= self.furthest and degrees(abs(atan2(y, x))) <= self.settings.sector

    def read(self) -> None:
        """Read the cube's state, and whether and where it landed since the last step."""
        super().read()
        cube = self.cube
        if self._status:
            return
        lowest = cube.lowest
        if self._flight is not None and lowest < BOUNCE:
            self._landing = self._flight.landing(self._robot.period)
        held = self._robot.pads_touching(cube.body) > 0
        if self._landing is not None:
            self._status = 1.0
        elif lowest < FLOOR_CONTACT:
            self._landing = cube.position[:2]
            self._status = -1.0 if held else 1.0
        self._flight = None if held else self._current_flight()
        if self._ends_at_release and self._flight is not None and not self._status:
            seconds = flight_time(cube.position[2], cube.velocity[2], self._gravity)
            self._landing = self._flight.landing(seconds, steps=FLIGHT_STEPS)
            self._status = float(self._landing is not None)

    def observe(self) -> list[float]:
        values = super().observe()
        (x, y, z), (vx, vy, vz) = values[:3], values[9:12]
        seconds = flight_time(z - self.cube.half, vz, self._gravity)
        return [*values, x + vx * seconds, y + vy * seconds, seconds]

    def _current_flight(self) -> Flight:
        cube = self.cube
        a, b, c, d, e, f = cube.columns
        axes = (a, b, c), (d, e, f), (b * f - c * e, c * d - a * f, a * e - b * d)
        return Flight(cube.position, cube.velocity, axes, cube.angular_velocity, cube.half, self._gravity)

    def achieved(self) -> FloatArray:
        x, y = self._landing or self.cube.position[:2]
        return np.array((x, y, self._status), np.float32)

    def expert(self) -> Expert:
        return ThrowExpert(self._robot, self)


def flight_time(height: float, rise: float, gravity: float) -> float:
    """Seconds until free fall from `height` m at `rise` m/s upwards comes to height 0, at most `LONGEST_FLIGHT`.

    The larger root of height + rise t + gravity t^2 / 2 = 0, gravity in m/s2 along z; 0 for a height below 0.
    """
    if height <= 0:
        return 0.0
    if gravity > -1e-6:
        return min(height / -rise, LONGEST_FLIGHT) if rise < 0 else LONGEST_FLIGHT
    return min((rise + sqrt(rise * rise - 2 * gravity * height)) / -gravity, LONGEST_FLIGHT)


class Flight(NamedTuple):
    """A cube in free flight."""

    position: Vector
    velocity: Vector
    axes: tuple[Vector, Vector, Vector]
    """Unit vectors along its edges."""
    angular_velocity: Vector
    """rad/s. It is constant: a cube's inertia is the same about every axis."""
    half: float
    """Half an edge in m."""
    gravity: float
    """m/s2 along z; negative pulls down."""

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
"""Seconds at constant speed after the release, in which the gripper opens."""
FLOOR_CLEARANCE = 0.12
"""Smallest height in m of the tool and of the swinging joints above the floor."""
BASE_CLEARANCE = 0.2
"""Smallest distance in m of the tool from the axis of the base joint while it is lower than .2 m above the first
swinging joint: there the arm's base stands."""
UNFOLDED = 0.4
"""Smallest distance of the tool from the first swinging joint as a fraction of the largest, so that the hand does not
meet the upper arm."""
GRID_POINTS = 9
"""Of the search along each joint; the grid then closes in on the best point."""
GRID_ROUNDS = 5
SLOWEST = 0.3
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
    rise = velocity.imag
    drop = np.maximum(position.imag - height, 0.0)
    seconds = (rise + np.sqrt(rise * rise - 2 * GRAVITY * drop)) / -GRAVITY
    distance: Array = position.real + velocity.real * seconds
    return distance


class ThrowPlanner:
    """Plans throws by kinematics alone: the furthest throw of a robot, and from it the throw at any nearer target.

    A throw turns the joints whose axes are horizontal and parallel ("swinging joints"), so that the tool moves in one
    vertical plane, each at a constant speed within its limit; the base joint turns that plane towards the target. The
    release is where the landing distance has its maximum along the motion: there an early or late opening matters
    least. Slower motions throw less far.

    Args:
        height: of the object's centre above the floor when it has landed, in m.

    Attributes:
        axis: x and y of the robot's axis, that of the base joint, in m.
        reach: the largest horizontal distance of the tool from the robot's axis, in m.
        furthest: the largest landing distance from that axis, in m.

    Raises:
        UsageError: no joint turns a vertical plane with two swinging joints in it, or actions do not turn joints.
    """

    def __init__(self, robot: RobotView, height: float) -> None:
        if not robot.turns_joints:
            raise UsageError(
                "cartesian control keeps the gripper pointing down and within the workspace, and no throw from there "
                "lands beyond the arm's reach",
                where="robot.control",
                hint="set robot.control: joint, which throws with the speed of every joint",
            )
        self._robot = robot
        self._height = height
        self._find_joints()
        limits = robot.limits
        self._home = np.array(robot.home_joints)
        speed = np.minimum(limits.velocity, np.array(robot.joint_step) / robot.period)
        # a joint that can make several turns is used from -pi to pi
        low = np.maximum(limits.lower, self._home - pi)
        high = np.minimum(limits.upper, self._home + pi)
        self._low, self._high, self._speed = low[self._swinging], high[self._swinging], speed[self._swinging]
        planar, self._span = self._search_reach()
        self.reach = hypot(planar, self._offset)
        self._release, self._velocities = self._search_throw()
        # landing distance and time of release of slower throws
        self._speeds = np.linspace(SLOWEST, 1.0, 71)
        times = np.linspace(-RUN_UP / 2, FOLLOW_THROUGH, 46)
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
            ahead = np.cross((0.0, 0.0, 1.0), normal)  # turning about the normal lifts what is ahead
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
                where="robot",
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

        A grid search that closes in on the best point.
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

    def _search_reach(self) -> tuple[float, float]:
        """The largest horizontal distance of the tool from the axis, and its largest distance from the first joint."""
        planar = self._search(lambda positions: self._points(positions)[:, -1].real, self._low, self._high)[1]
        span = self._search(lambda positions: abs(self._points(positions)[:, -1] - self._first), self._low, self._high)
        return planar, span[1]

    def _search_throw(self) -> tuple[Array, Array]:
        """Joint positions at the release and joint velocities of the furthest throw."""
        best: tuple[float, Array, Array] | None = None
        for signs in product((-1.0, 1.0), repeat=self._swinging.size):
            velocities = self._speed * signs
            before, after = velocities * RUN_UP, velocities * FOLLOW_THROUGH
            low = np.maximum(self._low, np.maximum(self._low + before, self._low - after))
            high = np.minimum(self._high, np.minimum(self._high + before, self._high - after))
            if (low > high).any():
                continue

            def objective(positions: Array, velocities: Array = velocities) -> Array:
                points = self._points(positions)
                distance = landing_distance(points[:, -1], self._velocity(points, velocities), self._height)
                return np.where(self._collision_free(positions, velocities), distance, -np.inf)

            positions, distance = self._search(objective, low, high)
            if np.isfinite(distance) and (best is None or distance > best[0]):
                best = distance, positions, velocities
        if best is None:
            raise UsageError("this arm has no room to swing", where="robot", hint="choose another robot")
        return best[1], best[2]

    def _collision_free(self, release: Array, velocities: Array) -> Array:
        """Whether throws (m, k) stay clear of the floor and the arm itself, on the way to their start too."""
        start, home = release - velocities * RUN_UP, self._home[self._swinging]
        middle, end = release - velocities * RUN_UP / 2, release + velocities * FOLLOW_THROUGH
        free = np.ones(len(release), np.bool_)
        for positions in (start, (2 * start + home) / 3, middle, release, end):
            points = self._points(positions)
            tool = points[:, -1]
            free &= (points[:, 1:].imag > FLOOR_CLEARANCE).all(1)
            free &= (tool.real > BASE_CLEARANCE) | (tool.imag > self._first.imag + BASE_CLEARANCE)
            free &= abs(tool - self._first) > UNFOLDED * self._span
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


RAMP = 0.32
"""Seconds in which the throw accelerates to its speed: the heaviest arm has the torque for it."""
DECELERATION = 3.0
"""rad/s2 with which joints come to rest at the start of the throw."""
SETTLED = 0.05, 0.3
"""rad and rad/s within which the arm is at rest at the start of the throw."""
PATIENCE = 40
"""Control steps after which the throw starts from the current position."""
POSITION_GAIN = 0.1
"""Fraction of its position error that a joint makes up for in a control step."""
VELOCITY_GAIN = 0.15
"""Fraction of a joint's velocity error by which its next steps are lengthened. Velocities follow actions a step or two
later: larger values of this and of `SPEED_GAIN` make the throw unstable."""
SPEED_GAIN = 0.6
"""Fraction of the missing distance by which the throw is sped up in a control step."""
LARGEST_SPEED_UP = 1.5
"""Largest factor by which the throw is sped up or slowed down."""
LOOK_AHEAD = 0.25
"""Seconds ahead in which the furthest landing is searched."""
LARGEST_CORRECTION = 0.8
"""Largest correction of a joint's change, as a fraction of its change at full speed."""
OPENING_DELAY = 0.01
"""Seconds from the command to open until the pads let go."""


class ThrowExpert(Expert):
    """Moves to the start of the throw, then each joint at its constant speed; opens where the landing is nearest."""

    def __init__(self, robot: RobotView, task: Throw) -> None:
        self._robot = robot
        self._task = task
        self.reset()

    def reset(self) -> None:
        x, y = self._task.goal.tolist()
        plan = self._task.planner.plan(x, y)
        self._velocities = np.array(plan.velocities)
        self._start = np.array(plan.release) - self._velocities * RUN_UP
        self._distance = self._task.planner.distance_along(x, y)
        self._steps = 0
        self._throwing = -1
        """Control steps since the throw began; -1 on the way to its start."""
        self._released = 0
        """The step of the throw in which the gripper began to open; 0 before."""
        self._correction = np.zeros_like(self._start)
        self._speed_up = 1.0
        self._elapsed = 0.0
        """Time in s along the plan."""

    def act(self) -> FloatArray:
        robot, period = self._robot, self._robot.period
        positions, velocities = np.array(robot.joint_positions), np.array(robot.joint_velocities)
        self._steps += 1
        to_start = self._start - positions
        near, slow = SETTLED
        moving = np.abs(to_start).max() > near or np.abs(velocities).max() > slow
        if self._throwing < 0 and moving and self._steps < PATIENCE:
            return robot.turning(self._approach(to_start).tolist(), 0.0)
        self._throwing += 1
        accelerated = self._throwing * period > RAMP
        if not self._released and accelerated and self._release_now(positions, velocities):
            self._released = self._throwing
        if self._released and self._throwing > self._released:  # a moving hand would hit the cube that leaves it
            return robot.turning([0.0] * len(positions), 1.0)
        if accelerated:
            speed_up = self._speed_up * (1 + SPEED_GAIN * self._shortfall(positions, velocities))
            self._speed_up = min(max(speed_up, 1 / LARGEST_SPEED_UP), LARGEST_SPEED_UP)
        # a joint that is slower than planned is told to go further, within its step
        planned = self._velocities * self._speed_up * min(1.0, self._throwing * period / RAMP)
        largest = LARGEST_CORRECTION * np.abs(self._velocities) * period
        correction = self._correction + VELOCITY_GAIN * (planned - velocities) * period
        self._correction = np.clip(correction, -largest, largest)
        error = to_start + self._velocities * self._elapsed
        # the speed in the middle of the next step
        elapsed = self._speed_up * min(1.0, (self._throwing + 0.5) * period / RAMP) * period
        self._elapsed += elapsed
        changes = self._velocities * elapsed + self._correction + POSITION_GAIN * error
        return robot.turning(changes.tolist(), float(self._released > 0))

    def _approach(self, to_start: Array) -> Array:
        """Changes of the joints, in proportion, on a straight way to the start, `to_start` (n,) in rad ahead."""
        distance = max(float(np.abs(to_start).max()), 1e-9)
        braking = (2 * DECELERATION * distance) ** 0.5 * self._robot.period  # v^2 = 2 a s
        steps = np.array(self._robot.joint_step) / np.maximum(np.abs(to_start), 1e-9)
        changes: Array = to_start * min(1.0, braking / distance, float(steps.min()))
        return changes

    def _landings(self, positions: Array, velocities: Array, times: Array) -> Array:
        """Landing distances (t,) for releases after `times` (t,) in s at the current joint velocities."""
        ahead = positions + np.multiply.outer(times, velocities)
        return self._task.planner.landing_of(ahead, np.broadcast_to(velocities, ahead.shape))

    def _shortfall(self, positions: Array, velocities: Array) -> float:
        """Missing distance to the target, as a fraction of it, if the throw continues at these velocities."""
        landings = self._landings(positions, velocities, np.linspace(0.0, LOOK_AHEAD, 13))
        return 1 - float(landings.max()) / self._distance

    def _release_now(self, positions: Array, velocities: Array) -> bool:
        """Whether opening now brings the cube nearer to the target than opening a control step later."""
        times = OPENING_DELAY + np.array((0.0, self._robot.period))
        now, later = np.abs(self._landings(positions, velocities, times) - self._distance)
        return bool(now <= later)
