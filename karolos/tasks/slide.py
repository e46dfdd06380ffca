"""Slide: the arm pushes a puck over a smooth floor, so that it comes to rest out of the arm's reach."""

from __future__ import annotations

from math import atan2, copysign, cos, hypot, pi, radians, sin, sqrt
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field as Setting

from ..core import Array, BoolArray, Expert, Field, FloatArray, Generator, Layout, Measure
from ..core.parameters import Drawn, Probability
from ..core.settings import LATER
from ..errors import UsageError
from ..simulation.geometry import Vector
from ..simulation.interface import FLOOR_FRICTION, GRAVITY, Box, Camera, Cup, RobotView, World
from ..simulation.shapes import Cylinder, Shape
from .cube import FIELDS, Cube, CubeSettings, CubeTask, aligned, check_pads, ground
from .point_goal import GOAL_COLOUR, PointGoal, sample_position
from .push import NEAR_DISTANCES, NEAR_HEIGHT, PUSHING_CLEARANCE, PushExpert, near_start
from .settings import drawn_stage, start

ROOM_BEHIND = 0.12
"""Length in m of the workspace behind a puck at the start, for the gripper."""
START_WIDTH = 0.2
"""Width in m of the box of start positions, in the middle of the workspace."""
ROOM_AHEAD = 0.05
"""Distance in m from the end of the workspace at which the arm releases the puck at the latest."""
USABLE_SPEED = 0.8
"""Share of the tool's largest speed that every arm reaches everywhere in its workspace, also sideways."""
BEYOND = 0.08
"""Distance in m outside the workspace beyond which no gripper touches the puck."""
BEHIND = pi / 4
"""Largest angle in rad between straight behind the puck and a start near it."""
HELD = 0.1, (0.035, 0.05), 0.0
"""Of a start with the puck between the fingers: that angle in rad, range of the distance from tool to puck along the
floor in m, and largest height of the tool in m. The expert pushes from 33 mm."""
LOST_PUCK = 1000.0
"""Distance in m from the origin beyond which a puck is lost. After a hard hit it slides over 10 m without an error."""


class Rest(PointGoal):
    """Success if the puck lies at rest, untouched, less than `threshold` m from the target.

    `achieved` (..., 3): the place of rest of an untouched puck (2, m), and 1 if it lies there. `desired` (..., 2): the
    target in m. Sparse reward: -1 until the place of rest is within `reward_share` of the threshold, and from there it
    rises from -`slope` to 0 at the target. Dense: minus the distance. A reward for lying there would come long after
    the last touch. Without a slope policies stop at the edge, which they reach first.
    """

    place = slice(2)

    def __init__(self, threshold: float, *, dense: bool, span: float, reward_share: float, slope: float = 0) -> None:
        super().__init__(threshold, dense=dense, span=span)
        self._near, self._slope = reward_share * threshold, slope

    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        metres = self.distance(achieved, desired)
        if self.dense:
            return -metres
        share = metres / self._near
        return -np.where(share < 1, self._slope * share, 1).astype(np.float32)

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        return (achieved[..., 2] > 0) & (self.distance(achieved, desired) < self.threshold)


class Puck(Cube):
    """A cylinder on its base, half as high as it is wide."""

    def shape(self, settings: Any) -> Shape:
        self.half, self.radius = settings.object_size / 4, settings.object_size / 2
        return Cylinder(self.radius, 2 * self.half)

    @property
    def lost(self) -> bool:
        x, y, z = self.position
        return not (z > -self.half and hypot(x, y) < LOST_PUCK)

    def moments(self, mass: float) -> Vector:
        across = mass * (self.radius**2 / 4 + self.half**2 / 3)
        return across, across, mass * self.radius**2 / 2


class Slide(CubeTask):
    """What to do: push the puck so that it slides to the target, beyond the arm's reach, and comes to rest there.

    What is randomised: the puck, in the near half of the workspace within 10 cm to either side; the target: within
    `sector` degrees to either side of straight ahead, beyond the arm's reach by at least `threshold`, and from there at
    most the fraction `share` of the way to the furthest slide. Stages that training may sample and tests never do:
    `start_held` (puck between the fingers) and, in the other episodes, `start_near` (gripper behind the puck).

    Observation: object_position (3, m), object_rotation (6, two columns of its matrix), object_velocity (3, m/s),
    object_angular_velocity (3, rad/s), object_from_tool (3, m), rest (2, m): where the puck would come to rest
    if nothing touched it from now on. Coordinates end at 1.5 times the distance of the furthest target from the base.
    Action: the robot's, without the gripper.
    Goals: achieved, where the puck comes to rest if nothing touches it any more (2, m), and whether it lies there (1);
    desired, the target (2, m).
    Reward: sparse -1, and more while the place of rest is within `reward_share` of the threshold; dense minus its
    distance; see `Rest`.
    What counts as success: the puck lies at rest within `threshold` of the target.
    Termination: never; the episode is truncated after `max_steps`, in training with probability `end_out_of_reach`
    already when the puck has left the workspace.

    The furthest slide follows from the speed of the tool and the friction, which is the product of the floor's and the
    puck's.
    """

    class Settings(CubeSettings):
        object_size: float = Setting(0.06, ge=0.03, le=0.1, description="diameter of the puck, m; it is half as high")
        object_friction: Annotated[float, Drawn("1", 0.01, 0.02)] = Setting(
            0.015, ge=0.001, le=1, description="lateral friction coefficient of the puck; half of it on the floor"
        )
        reward: Literal["sparse", "dense"] = Setting(
            "sparse", description="-1 until the puck is on its way to the target, or minus the distance"
        )
        threshold: float = Setting(0.05, gt=0, le=0.5, description="distance at which the target is hit, m")
        reward_share: float = Setting(
            1.0, gt=0, le=1, description="share of the threshold within which the sparse reward counts"
        )
        reward_slope: float = Setting(
            0.0,
            ge=0,
            le=1,
            json_schema_extra=LATER,
            description="the sparse reward is 0 at the target, and minus this at the edge of that share",
        )
        share: float = Setting(0.5, gt=0, le=1, description="share of the possible distances in which targets lie")
        sector: float = Setting(15.0, gt=0, le=60, description="largest angle of targets to both sides, degrees")
        start_held: Probability = start("the puck between the fingers", json_schema_extra=LATER)
        start_near: Probability = start("the gripper behind the puck")
        end_out_of_reach: Probability = Setting(
            0.0, description="probability that an episode ends as soon as no gripper can reach the puck"
        )
        max_steps: int = Setting(200, ge=1, le=100_000, description="control steps per episode")

    settings: Settings
    drawn: Settings
    observation = Layout((*FIELDS, Field("rest", 2, "m", kind="point")))
    object_class = Puck
    uses_gripper = False
    protective_stop = False  # a learning policy presses on the floor; `force_penalty` teaches it not to
    fingers = 0.5  # the puck lies between them and goes where they go
    camera = Camera(target=(0.8, 0.0, 0.2), distance=3.4, yaw=22.0, pitch=-25.0)
    achieved_goal = Layout((Field("rest", 2, "m", kind="point"), Field("lies", 1, kind="scalar")))
    desired_goal = Layout((Field("target", 2, "m", kind="point"),))
    distance_measure = Measure("miss", "m", "smaller", "distance of the target from where the puck comes to rest")

    def __init__(self, settings: Slide.Settings) -> None:
        super().__init__(settings)
        self._gravity, self._floor = GRAVITY, FLOOR_FRICTION

    def fit(self, robot: RobotView) -> None:
        settings, box, self._robot = self.settings, robot.workspace, robot
        rest = settings.object_size / 4
        if isinstance(robot.gripper, Cup):
            check_pads(robot, type(self).__name__, "takes the puck between fingers")
        ground(box, "box", max(rest, box.low[2]))
        self.axis, centre = robot.base[:2], box.centre[:2]
        ways = [middle - base for middle, base in zip(centre, self.axis, strict=True)]
        k = int(abs(ways[1]) > abs(ways[0]))
        side = copysign(1.0, ways[k])
        self.ahead = (0.0, side) if k else (side, 0.0)
        """Unit vector along the world's axis from the base to the workspace."""
        depth, width = (box.high[one] - box.low[one] for one in (k, 1 - k))
        near = [centre[k] - side * max(depth / 2 - ROOM_BEHIND, 0.0), centre[k]]
        across = [centre[1 - k] - min(START_WIDTH, width) / 2, centre[1 - k] + min(START_WIDTH, width) / 2]
        xs, ys = (across, sorted(near)) if k else (sorted(near), across)
        self.starts = Box((xs[0], ys[0], rest), (xs[1], ys[1], rest))
        self.nearest = reach(robot) + settings.threshold
        slide = (USABLE_SPEED * robot.tool_step / robot.period) ** 2 / (2 * self.deceleration)
        most = abs(ways[k]) + depth / 2 - ROOM_AHEAD + slide
        self.furthest = self.nearest + settings.share * (most - self.nearest)
        if self.furthest <= self.nearest:
            raise UsageError(
                f"a puck slides at most to {most:.2f} m from the base; reach of the arm and threshold are "
                f"together {self.nearest:.2f} m",
                setting="task.object_friction",
                hint="a smaller friction or a larger robot.tool_step lets it slide further",
            )
        self.sight = 1.5 * self.furthest
        """Largest observed coordinate in m. Networks scale inputs by their spread, and a puck can slide 20 m."""
        span = 3 * self.sight
        dense = settings.reward == "dense"
        shares = {"reward_share": settings.reward_share, "slope": settings.reward_slope}
        self.goal_rule = Rest(settings.threshold, dense=dense, span=span, **shares)

    @property
    def deceleration(self) -> float:
        """Deceleration of the sliding puck by Coulomb's friction, in m/s2."""
        return max(-self.drawn.object_friction * self._floor * self._gravity, 1e-3)

    def build(self, world: World) -> None:
        super().build(world)
        self._robot.touches_others()  # starts the record of forces
        self._marker = world.marker(self.settings.threshold, GOAL_COLOUR)

    def apply(self, world: World, name: str, value: float) -> None:
        super().apply(world, name, value)
        if name == "gravity":
            self._gravity = value
        elif name == "floor_friction":
            self._floor = value

    def reset(self, generator: Generator) -> None:
        x, y, z = sample_position(generator, self.starts, "the puck").tolist()
        self.stage = drawn_stage(self.drawn, generator.uniform(), "held", "near")
        if self.stage:
            behind = atan2(-self.ahead[1], -self.ahead[0])
            aside, distances, above = HELD if self.stage == "held" else (BEHIND, NEAR_DISTANCES, NEAR_HEIGHT)
            ways = behind - aside, behind + aside
            tool = near_start(self._robot, (x, y, z), generator, ways, distances, above)
            self.cube.place_with_tool(self._robot, (x, y, z), tool, 0.0)
        else:
            self.cube.place((x, y, z), aligned(self._robot))
        angle = radians(self.settings.sector) * generator.uniform(-1, 1)
        far, (ax, ay) = generator.uniform(self.nearest, self.furthest), self.ahead
        turned = ax * cos(angle) - ay * sin(angle), ay * cos(angle) + ax * sin(angle)
        self.goal = np.array([base + far * way for base, way in zip(self.axis, turned, strict=True)], np.float32)
        self._marker.place((*self.goal.tolist(), 0.0))
        self.lies = True
        self._ends = generator.uniform() < self.drawn.end_out_of_reach

    def read(self) -> None:
        super().read()
        self.lies = self.let_go()

    def over(self) -> bool:
        x, y, z = self.cube.position
        return self._ends and not self._robot.workspace.contains((x, y, max(z, self._robot.workspace.low[2])), BEYOND)

    def rest(self, position: list[float] | Vector, velocity: list[float] | Vector) -> tuple[float, float]:
        """Place of rest of an untouched puck, in m. Coordinates end at `sight`."""
        seconds = hypot(velocity[0], velocity[1]) / (2 * self.deceleration)
        return self._seen(position[0] + velocity[0] * seconds), self._seen(position[1] + velocity[1] * seconds)

    def _seen(self, coordinate: float) -> float:
        return min(max(coordinate, -self.sight), self.sight)

    def observe(self) -> list[float]:
        values = super().observe()
        rest = self.rest(values[:3], values[9:12])
        for place in (0, 1, 15, 16):  # position, and position from the tool
            values[place] = self._seen(values[place])
        return [*values, *rest]

    def achieved(self) -> FloatArray:
        return np.array((*self.rest(self.cube.position, self.cube.velocity), self.lies), np.float32)

    def expert(self) -> Expert:
        return SlideExpert(self._robot, self, self.settings.threshold)


def reach(robot: RobotView) -> float:
    """The largest horizontal distance of the tool from the robot's base in m, found by turning one joint at a time."""
    joints, limits = list(robot.home_joints), robot.limits
    best = 0.0
    for _ in range(8):
        for joint, (low, high) in enumerate(zip(limits.lower, limits.upper, strict=True)):
            for angle in np.linspace(max(low, joints[joint] - pi), min(high, joints[joint] + pi), 33).tolist():
                x, y, _ = robot.forward([*joints[:joint], angle, *joints[joint + 1 :]]).tool.position
                if (far := hypot(x - robot.base[0], y - robot.base[1])) > best:
                    best, joints[joint] = far, angle
    return best


NUDGE = 0.1
"""Speed in m/s of the fingers when they touch the puck: after a harder hit it leaves them again."""
SPEED_UP = 0.12
"""Largest commanded speed of the tool relative to the puck, in m/s."""
GAIN = 0.35
"""Share of a missing velocity that is added to the commanded one in each control step."""
ENOUGH = 0.99
"""Share of the speed that the puck needs at which it is released."""


class SlideExpert(PushExpert):
    """Goes behind the puck, takes it between the fingers, and pushes it until it slides to the target by itself."""

    _task: Slide

    def reset(self) -> None:
        super().reset()
        self._left = False
        self._told = self._nudge = NUDGE * self._task.ahead[0], NUDGE * self._task.ahead[1]
        """Commanded velocity of the tool along x and y, in m/s."""

    def act(self) -> FloatArray:
        robot, task, (tx, ty, _) = self._robot, self._task, self._robot.tool_position
        (x, y, z), (vx, vy, _), (gx, gy) = task.cube.position, task.cube.velocity, task.goal.tolist()
        distance = hypot(gx - x, gy - y)
        ux, uy = (gx - x) / distance, (gy - y) / distance
        speed, wanted = vx * ux + vy * uy, sqrt(2 * task.deceleration * distance)
        self._left = (self._left or speed > ENOUGH * wanted) and not task.cube.at_rest
        if self._left:
            return robot.towards(robot.tool_position, 0.0)
        low = max(z, robot.workspace.low[2] + PUSHING_CLEARANCE)
        ax, ay = task.ahead
        along, way = self._behind(ax, ay, low)
        if way is not None or task.cube.at_rest:
            self._told, along = self._nudge, along + NUDGE * robot.period
            return robot.towards(way or (x + ax * along, y + ay * along, low), 0.0)
        wx, wy = self._told
        wx += GAIN * (wanted * ux - robot.tool_velocity[0])
        wy += GAIN * (wanted * uy - robot.tool_velocity[1])
        slower = min(1.0, (speed + SPEED_UP) / hypot(wx, wy))
        self._told = wx, wy = wx * slower, wy * slower
        return robot.towards((tx + wx * robot.period, ty + wy * robot.period, low), 0.0)
