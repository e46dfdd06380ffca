"""Reorient: the gripper brings a box or a cylinder to a pose, on the floor or in the air."""

from __future__ import annotations

from math import atan2, hypot, pi, sqrt
from typing import Annotated, Any, Literal

from pydantic import Field as Setting

from ..core import Expert, FloatArray, Generator, Layout
from ..core.parameters import Drawn, Probability
from ..core.settings import LATER
from ..errors import UsageError
from ..simulation.geometry import (
    UPRIGHT,
    Box,
    Quaternion,
    Vector,
    axes,
    inverse,
    multiply,
    rotated,
    rotation_about,
    rotation_vector,
)
from ..simulation.interface import RobotView, Stroke, World
from ..simulation.shapes import Cuboid, Cylinder, Shape, inertia_of
from .cube import (
    CARRYING_CLEARANCE,
    GRIP_HEIGHT,
    HOVER_HEIGHT,
    Cube,
    CubeSettings,
    CubeTask,
    braking,
    check_pads,
    drift,
)
from .point_goal import GOAL_COLOUR, sample_position
from .pose_goal import PoseGoal, check_turning, pose_array, pose_fields, sample_orientation
from .reach_pose import AXIS_COLOURS, GOAL_BOX
from .settings import drawn_stage, start

EDGES = (1.0, 4 / 3, 2.0)
"""Edges of the box in units of the smallest one. The cylinder has the length of the longest and the thickness of the
second. A hand that holds a longer standing object would press on its top."""
LYING: Quaternion = (sqrt(0.5), 0.0, 0.0, sqrt(0.5))
"""The rotation that lays the object down. A gripper then holds it by the same sides as when it stands."""
HALF_TURNS: tuple[Quaternion, ...] = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
"""Half turns about each axis, which do not change a box."""
HIGHEST = 0.15
"""Largest height in m of goals in the air above the object's when it rests on the floor."""
OVER_TOP = (0.012, 0.04)
"""Height in m of the tool above the top of the object in episodes that start over it. The pads reach a bit lower."""
TURN_SHARE = 0.9
"""Share of the tool's largest turn by which object and goals are turned."""


class ReorientSettings(CubeSettings):
    """Settings of reorient."""

    shape: Literal["box", "cylinder"] = Setting(
        "box", description="box: edges of 1, 4/3 and 2 times its size; cylinder: 2 times long and 4/3 thick"
    )
    object_size: float = Setting(0.03, ge=0.015, le=0.05, description="smallest edge of the box, m")
    object_friction: Annotated[float, Drawn("1", 0.3, 5.0)] = Setting(
        1.0, ge=0, le=5, description="lateral friction coefficient of the object"
    )
    reward: Literal["sparse", "dense"] = Setting(
        "sparse", description="-1 until success, or minus the distance in m and .1 m per rad"
    )
    threshold: float = Setting(0.02, gt=0, le=0.1, description="distance at which the position is reached, m")
    angle_threshold: float = Setting(
        pi / 12, gt=0, le=1, description="angle at which the orientation is reached, rad; default: 15 degrees"
    )
    lying: Probability = Setting(0.5, description="share of episodes in which the object lies; else it stands")
    in_air: Probability = Setting(
        0.6, json_schema_extra=LATER, description="share of goals in the air; else on the floor"
    )
    lowest_air: Annotated[float, Drawn("m", 0.0, 0.1)] = Setting(
        0.03,
        ge=0,
        le=0.1,
        json_schema_extra=LATER,
        description="lowest goal in the air, as a height above the object on the floor, m",
    )
    topple_cost: float = Setting(
        0.0,
        ge=0,
        le=1,
        json_schema_extra=LATER,
        description="cost of each step in which an object lies that stood at the start; it cannot be put up again",
    )
    end_toppled: Probability = Setting(
        0.0, json_schema_extra=LATER, description="probability that an episode ends when the object topples"
    )
    start_carried: Probability = start("the object in the gripper, somewhere in the air")
    start_grasped: Probability = start("the object in the gripper")
    start_over: Probability = start("the gripper directly over the object, at a random angle and opening")
    start_near: Probability = start("the gripper near the object")
    max_steps: int = Setting(70, ge=1, le=100_000, description="control steps per episode")


UPWARDS = 0.7
"""Height of a unit vector that counts as upwards: 45 degrees."""


class Piece(Cube):
    """A box or a cylinder. Its third axis is along its length, its first along the width that a gripper holds."""

    def shape(self, settings: Any) -> Shape:
        size: float = settings.object_size
        self.edges = x, y, z = tuple(size * edge for edge in EDGES)
        self.round, self.half = settings.shape == "cylinder", z / 2
        self.width = y if self.round else x
        """Width between the pads, in m."""
        shape: Shape = Cylinder(y / 2, z) if self.round else Cuboid((x, y, z))
        self.inertia = inertia_of([shape], 1.0).moments
        """Principal moments of 1 kg, in kg m2."""
        return shape

    def moments(self, mass: float) -> Vector:
        a, b, c = self.inertia
        return mass * a, mass * b, mass * c

    @property
    def lowest(self) -> float:
        heights = [abs(axis[2]) for axis in axes(self.orientation)]
        if self.round:
            return self.position[2] - self.half * heights[2] - self.width / 2 * sqrt(max(1 - heights[2] ** 2, 0.0))
        return self.position[2] - sum(edge / 2 * height for edge, height in zip(self.edges, heights, strict=True))

    def across(self) -> float:
        """Yaw in rad along which pads hold it, whichever axis points upwards."""
        first, second, third = axes(self.orientation)
        if self.round:
            x, y, z = third
            return atan2(x, -y) if abs(z) < UPWARDS else 0.0
        x, y, _ = first if abs(first[2]) < UPWARDS else second
        return atan2(y, x)


class Reorient(CubeTask):
    """What to do: bring a box or a cylinder to a pose: to within 2 cm and 15 degrees, on the floor or in the air.

    A gripper that points down can turn the object about the vertical, and tilt it only a little. An object that lies at
    the start therefore has a lying goal, and a standing object a standing goal.

    What is randomised: whether the object lies or stands; position and turn of object and goal, in a box of .16 by .24
    m in the middle of the robot's dexterous space, turned by up to .72 rad to either side (built-in arms). 40 % of the
    goals lie on the floor, 60 % in the air, .03 to .15 m higher and tilted by up to .3 rad. Stages that training may
    sample and tests never do, each among the episodes without an earlier stage: `start_carried` (object in the gripper
    somewhere in the air), `start_grasped` (object in the gripper where it is), `start_over` (gripper right over it,
    with any turn and opening), `start_near` (open gripper around or above it).

    Observation: object_position (3, m), object_rotation (6, two columns of its matrix), object_velocity (3, m/s),
    object_angular_velocity (3, rad/s), object_from_tool (3, m).
    Action: the robot's, with the gripper.
    Goals: achieved, position (3, m) and rotation (6, the first two columns of its matrix) of the object; desired, the
    same of the goal.
    Reward: sparse -1 until the goal is reached, then 0; dense minus the distance in m, minus .1 m per rad of the angle.
    Minus `topple_cost` while an object lies that stood at the start.
    What counts as success: the object lies within `threshold` of the goal and is turned by less than `angle_threshold`
    from it. A half turn about each axis does not change a box. Turns about its length and reversal do not change a
    cylinder.
    Termination: never; the episode is truncated after `max_steps`, with probability `end_toppled` already when the
    object topples; as a parameter of domain randomization only in training.
    """

    Settings = ReorientSettings
    settings: ReorientSettings
    drawn: ReorientSettings
    object_class = Piece
    uses_gripper = True
    control = "pose"
    protective_stop = False  # a hand that comes down on the object presses with more than the limit
    achieved_goal = Layout(pose_fields("object"))
    desired_goal = Layout(pose_fields("goal"))
    cube: Piece

    def __init__(self, settings: ReorientSettings) -> None:
        super().__init__(settings)
        low, high = self.extra_reward_range
        self.extra_reward_range = low - settings.topple_cost, high

    def fit(self, robot: RobotView) -> None:
        self._robot, settings = robot, self.settings
        dexterous = check_turning(robot)
        self.gripper = check_pads(robot, type(self).__name__, "turns what it holds")
        if EDGES[1] * settings.object_size > 0.7 * self.gripper.width:
            raise UsageError(
                f"an object of {settings.object_size:g} m does not fit into the gripper",
                setting="task.object_size",
                hint=f"it opens {self.gripper.width:g} m, and the object is 4/3 of its size wide",
            )
        self.box, self.highest = dexterous.middle(GOAL_BOX), dexterous.high[2]
        flips = HALF_TURNS[:1] if settings.shape == "cylinder" else HALF_TURNS
        self.goal_rule = PoseGoal(
            settings.threshold,
            settings.angle_threshold,
            dense=settings.reward == "dense",
            span=10.0 + robot.workspace.diagonal,
            symmetries=flips,
            axis=(0.0, 0.0, 1.0) if settings.shape == "cylinder" else None,
        )

    def build(self, world: World) -> None:
        super().build(world)
        self._marker = world.marker(0.015, GOAL_COLOUR)

    def reset(self, generator: Generator) -> None:
        robot, piece = self._robot, self.cube
        self.closing_yaw = closing_yaw(robot)
        lies = generator.uniform() < self.drawn.lying
        held = multiply(rotation_about((0.0, 0.0, self.closing_yaw)), LYING if lies else UPRIGHT)
        """Rotation of the object in a gripper that points down as at home."""
        rest = piece.edges[1 if lies else 2] / 2
        ground = Box((*self.box.low[:2], rest), (*self.box.high[:2], rest))
        middle, turn = robot.orientations.middle, TURN_SHARE * robot.orientations.turn

        def pose(air: bool) -> tuple[Vector, Quaternion]:
            """Position of the object, and orientation of the tool that holds it."""
            x, y, z = sample_position(generator, ground, "the object").tolist()
            if not air:
                return (x, y, z), robot.orientations.at(0.0, 0.0, generator.uniform(-turn, turn))
            return (x, y, min(z + generator.uniform(self.drawn.lowest_air, HIGHEST), self.highest)), sample_orientation(
                generator, robot.orientations
            )

        def turned(tool: Quaternion) -> Quaternion:
            return multiply(multiply(tool, inverse(middle)), held)

        stage = self.stage = drawn_stage(self.drawn, generator.uniform(), "carried", "grasped", "over", "near")
        (x, y, z), tool = pose(air=stage == "carried")
        orientation = turned(tool)
        above, opening = GRIP_HEIGHT, piece.width / self.gripper.width
        if stage == "near":
            above, opening = generator.uniform(GRIP_HEIGHT, HOVER_HEIGHT), 1.0
        elif stage == "over":
            above, opening = rest + generator.uniform(*OVER_TOP), generator.uniform()
            tool = robot.orientations.at(0.0, 0.0, generator.uniform(-turn, turn))
        if stage:
            place = x, y, max(z + above, robot.workspace.low[2])
            robot.place_tool(place, opening, orientation=tool, closing=stage in ("carried", "grasped"))
        piece.place((x, y, z), orientation)
        start_pose = self.achieved()
        while True:
            position, tool = pose(air=generator.uniform() < self.drawn.in_air)
            self.goal_position, self.goal_rotation = position, turned(tool)
            self.goal = pose_array(position, self.goal_rotation)
            if not self.goal_rule.success(start_pose, self.goal):
                break
        self._marker.place(self.goal_position)
        self._lies = lies
        # sampled only if it is set: what is sampled later in an episode stays the same without it
        self._ends = self.drawn.end_toppled > 0 and generator.uniform() < self.drawn.end_toppled

    @property
    def toppled(self) -> bool:
        """Whether the object stood at the start and lies now."""
        return not self._lies and abs(axes(self.cube.orientation)[2][2]) < UPWARDS

    def over(self) -> bool:
        return self._ends and self.toppled

    def extra_reward(self) -> float:
        return super().extra_reward() - self.settings.topple_cost * self.toppled

    def achieved(self) -> FloatArray:
        return pose_array(self.cube.position, self.cube.orientation)

    def strokes(self) -> list[Stroke]:
        """The axes of the object at the goal, in both directions."""
        found = []
        for axis, edge, colour in zip(axes(self.goal_rotation), self.cube.edges, AXIS_COLOURS, strict=True):
            x, y, z = self.goal_position
            a, b, c = (edge * part for part in axis)
            found.append(Stroke([(x - a, y - b, z - c), (x + a, y + b, z + c)], colour))
        return found

    def expert(self) -> Expert:
        return ReorientExpert(self._robot, self)


def closing_yaw(robot: RobotView) -> float:
    """Yaw in rad of the direction in which the pads close, with the tool as at home."""
    along = robot.closing
    x, y = (abs(sum(a * b for a, b in zip(along, axis, strict=True))) for axis in (robot.tool.x, robot.tool.y))
    return robot.home_yaw + (pi / 2 if y > x else 0.0)


ROOM, CLOSED = 0.03, 0.004
"""Opening of the gripper beyond the object's width in m: for the approach, and the largest one while it holds it."""
OVER, STRAIGHT = 0.01, 0.1
"""Largest distance from the object's axis in m, and largest turn of the tool to it in rad, at which it goes down."""
NEAR = 0.012
"""Largest distance in m of the tool from the place of the grip, along each axis, at which it closes."""
TURNED = 0.1
"""Largest angle in rad to the goal's rotation at which an object may go down to it."""
PATIENCE = 30
"""Control steps after which a gripper that has closed on nothing opens again."""


class ReorientExpert(Expert):
    """Goes over the object, turns the tool, goes down, closes, lifts, turns the object and moves it to the goal."""

    def __init__(self, robot: RobotView, task: Reorient) -> None:
        self._robot, self._task = robot, task
        self._closing = 0
        """Control steps since the gripper began to close; 0 while it is open."""

    def reset(self) -> None:
        self._closing = 1 if self._holding() else 0

    def _apart(self) -> float:
        """Distance in m of the tool from the place of the grip."""
        (x, y, z), (tx, ty, tz) = self._task.cube.position, self._robot.tool_position
        return max(abs(tx - x), abs(ty - y), abs(tz - max(z + GRIP_HEIGHT, self._robot.workspace.low[2])))

    def _holding(self) -> bool:
        task, robot = self._task, self._robot
        wide = task.cube.edges[1] + CLOSED
        return self._apart() < 2 * NEAR and robot.opening * task.gripper.width < wide

    def act(self) -> FloatArray:
        robot, task, piece = self._robot, self._task, self._task.cube
        (x, y, z), (tx, ty, tz) = piece.position, robot.tool_position
        if self._closing:
            self._closing += 1
            if self._holding() and robot.pads_touching(piece.body) == 2:
                return self._carry()
            if self._closing < PATIENCE and self._apart() < 2 * NEAR:
                return robot.towards((tx, ty, tz), 0.0, robot.tool.orientation)
            self._closing = 0
        stands = abs(axes(piece.orientation)[2][2]) > UPWARDS
        turn = 0.0 if piece.round and stands else piece.across() - task.closing_yaw
        orientation = robot.orientations.at(0.0, 0.0, turn - pi * round(turn / pi))
        off = hypot(*rotation_vector(multiply(orientation, inverse(robot.tool.orientation))))
        beside, grip = hypot(tx - x, ty - y), max(z + GRIP_HEIGHT, robot.workspace.low[2])
        high, opening = tz > z + HOVER_HEIGHT / 2, (piece.edges[1] + ROOM) / task.gripper.width
        if beside > OVER or off > STRAIGHT or (high and drift(robot) > OVER):
            above: Vector = (x, y, z + HOVER_HEIGHT) if high or beside < OVER else (tx, ty, z + HOVER_HEIGHT)
            return robot.towards(braking(robot, above), opening, orientation)
        self._closing = int(abs(tz - grip) < NEAR / 2 and drift(robot) < OVER)
        return robot.towards(braking(robot, (x, y, grip)), 0.0 if self._closing else opening, orientation)

    def _turn(self) -> Quaternion:
        """The smallest rotation of the object to the goal, symmetries counted."""
        now, wanted = self._task.cube.orientation, self._task.goal_rotation
        if not self._task.cube.round:
            ways = [multiply(multiply(wanted, one), inverse(now)) for one in (UPRIGHT, *HALF_TURNS)]
            return min(ways, key=lambda way: hypot(*rotation_vector(way)))
        (a, b, c), (x, y, z) = axes(now)[2], axes(wanted)[2]
        side = 1.0 if a * x + b * y + c * z > 0 else -1.0
        cross = side * (b * z - c * y), side * (c * x - a * z), side * (a * y - b * x)
        share = atan2(hypot(*cross), abs(a * x + b * y + c * z)) / max(hypot(*cross), 1e-9)
        return rotation_about([share * value for value in cross])

    def _carry(self) -> FloatArray:
        robot, task, piece = self._robot, self._task, self._task.cube
        turn, tool = self._turn(), robot.tool_position
        arm = rotated(turn, [t - p for t, p in zip(tool, piece.position, strict=True)])
        x, y, z = (goal + ahead for goal, ahead in zip(task.goal_position, arm, strict=True))
        off, low = hypot(*rotation_vector(turn)), piece.lowest
        if hypot(x - tool[0], y - tool[1]) > OVER or off > TURNED:
            if low < CARRYING_CLEARANCE / 2:
                return robot.towards((tool[0], tool[1], tool[2] + CARRYING_CLEARANCE), 0.0, robot.tool.orientation)
            z = max(z, tool[2] + CARRYING_CLEARANCE - low)
        return robot.towards((x, y, max(z, robot.workspace.low[2])), 0.0, multiply(turn, robot.tool.orientation))
