"""Cubes that tasks move: settings, bodies, observation, places on the floor, and the expert that grips and carries."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, hypot, pi, sin
from typing import Annotated, Any, ClassVar

from pydantic import Field as Setting

from ..core import Field, FloatArray, Generator, Layout
from ..core import Settings as BaseSettings
from ..core.parameters import Drawn
from ..errors import UsageError
from ..simulation.geometry import UPRIGHT, Colour, Quaternion, Vector, columns
from ..simulation.interface import Ability, Box, Cup, Gripper, Material, RobotView, Task, World
from ..simulation.shapes import Cuboid, Shape
from .settings import ForcePenalty, seen

CUBE_COLOUR = (0.93, 0.45, 0.13, 1.0)
LOST_DISTANCE = 10.0
"""Largest distance in m from the origin. If an object is further away, or below the floor, the physics diverged."""
GROUND_EDGE = 0.3
"""Edge in m of the square for cube and goal in the middle of the workspace, as in panda-gym."""
REST_SPEED = 0.01
"""Speed in m/s below which an object is at rest."""
BRAKING_SHARE = 0.5
"""Largest share of the remaining distance in one control step: an arm at full speed needs two steps to brake."""


def fields(name: str) -> tuple[Field, ...]:
    """The observed fields of an object. The rotation is the first two columns of its matrix, see `geometry.columns`."""
    return (
        Field(f"{name}_position", 3, "m", kind="point"),
        Field(f"{name}_rotation", 6, kind="rotation"),
        Field(f"{name}_velocity", 3, "m/s", kind="vector"),
        Field(f"{name}_angular_velocity", 3, "rad/s", kind="axial"),
        Field(f"{name}_from_tool", 3, "m", kind="vector"),
    )


FIELDS = fields("object")
"""Observation of a task with one object."""


class CubeSettings(BaseSettings):
    """Settings of every task with a cube."""

    object_size: float = Setting(0.04, ge=0.01, le=0.2, description="edge of the cube, m")
    object_mass: Annotated[float, Drawn("kg", 0.01, 2.0)] = Setting(
        0.1, gt=0, le=5, description="mass of the cube, kg; its inertia is proportional to the mass"
    )
    object_friction: Annotated[float, Drawn("1", 0.0, 5.0)] = Setting(
        1.0, ge=0, le=5, description="lateral friction coefficient of the cube"
    )
    object_stiffness: float | None = Setting(
        None, ge=1e3, le=1e8, description="stiffness of the cube's contacts, N/m; null: 4e5 (MuJoCo), or PyBullet's own"
    )
    force_penalty: ForcePenalty | None = Setting(
        None, description="cost of the largest force on a link of arm or gripper; null: none"
    )


class Cube:
    """A cube of a world: built once, placed at a reset, read after each step. A subclass has another shape."""

    def __init__(self, settings: CubeSettings, world: World, colour: Colour = CUBE_COLOUR) -> None:
        mass, shape = settings.object_mass, self.shape(settings)
        self.body = world.body([shape], mass, colour)
        self.body.set_friction(settings.object_friction)
        if settings.object_stiffness is not None:
            self.body.set_material(Material(stiffness=settings.object_stiffness))
        self.set_mass(mass)

    def shape(self, settings: Any) -> Shape:
        """The shape that the task's settings describe; sets `half`, half its height in m."""
        size: float = settings.object_size
        self.half = size / 2
        return Cuboid((size, size, size))

    def moments(self, mass: float) -> Vector:
        """Principal moments of inertia in kg m2: m a^2 / 6 about every axis."""
        inertia = mass * (2 * self.half) ** 2 / 6
        return inertia, inertia, inertia

    def set_mass(self, mass: float) -> None:
        """Set the mass in kg, and the inertia of a solid body."""
        self.body.set_inertia(mass, self.moments(mass))

    def place(self, position: Sequence[float], orientation: Quaternion = UPRIGHT) -> None:
        """Place the cube there at rest, and read its state."""
        x, y, z = position
        self.body.place((x, y, z), orientation)
        self.read()

    def put_in_gripper(self, robot: RobotView, gripper: Gripper | Cup, position: Vector) -> None:
        """As `place_with_tool`, with the tool around the cube and closing pads at its sides, or with a cup on it."""
        x, y, z = position
        opening = 2 * self.half / gripper.width if isinstance(gripper, Gripper) else 0.0
        self.place_with_tool(robot, position, (x, y, z + self.rise(gripper)), opening, closing=True)

    def rise(self, gripper: Gripper | Cup) -> float:
        """Height in m of the tool above the centre when the cube is held."""
        return self.half if isinstance(gripper, Cup) else 0.0

    def place_with_tool(
        self, robot: RobotView, position: Sequence[float], tool: Vector, opening: float, *, closing: bool = False
    ) -> None:
        """During a reset: place the cube there at rest and the tool near it, with this opening of the gripper (0 to 1).

        Raises PluginError if the tool cannot be there.
        """
        robot.place_tool(tool, opening, closing=closing)
        self.place(position, aligned(robot))

    def read(self) -> None:
        """Read position (m), rotation (quaternion) and velocities (m/s, rad/s) from the world."""
        self.position, self.orientation = self.body.pose()
        self.velocity, self.angular_velocity = self.body.velocity()

    @property
    def lowest(self) -> float:
        """Height of the lowest corner above the floor in m."""
        x, y, z, w = self.orientation
        upright = abs(2 * (x * z - w * y)) + abs(2 * (y * z + w * x)) + abs(1 - 2 * (x * x + y * y))
        return self.position[2] - self.half * upright

    def observe(self, robot: RobotView) -> list[float]:
        """The numbers of `fields`, with the robot's observation noise.

        The offset from the tool is computed from the observed positions, so it adds no information.
        """
        place, turned = seen(robot, self.position), columns(self.orientation)
        values = robot.with_noise([*place, *turned, *self.velocity, *self.angular_velocity])
        return values + [own - tool for own, tool in zip(values, robot.observed_tool_position, strict=False)]

    @property
    def at_rest(self) -> bool:
        """Whether it is slower than `REST_SPEED`."""
        x, y, z = self.velocity
        return x * x + y * y + z * z < REST_SPEED * REST_SPEED

    @property
    def lost(self) -> bool:
        """Whether it is below the floor, more than 10 m away, or NaN."""
        x, y, z = self.position
        return not (z > -self.half and x * x + y * y + z * z < LOST_DISTANCE * LOST_DISTANCE)


def aligned(robot: RobotView) -> Quaternion:
    """The upright rotation, at most 45 degrees, in which a cube's sides face the pads of the gripper at home.

    Not every robot can turn its gripper. A cube gripped by its edges stays oblique, and the grip is weak.
    """
    quarter = pi / 2
    angle = robot.home_yaw - quarter * round(robot.home_yaw / quarter)
    return 0.0, 0.0, sin(angle / 2), cos(angle / 2)


class CubeTask(Task):
    """The common part of tasks with cubes. A task sets `_robot` in `fit`. `cube` is the first of `cubes`."""

    observation = Layout(FIELDS)
    colours: ClassVar[Sequence[Colour]] = (CUBE_COLOUR,)
    """Possible colours of the cubes; `number` of them are used."""
    number = 1
    object_class: ClassVar[type[Cube]] = Cube
    settings: CubeSettings
    _robot: RobotView

    def __init__(self, settings: CubeSettings) -> None:
        super().__init__(settings)
        if settings.force_penalty is not None:
            self.extra_reward_range = -settings.force_penalty.most, 0.0

    @property
    def engine_needs(self) -> dict[str, Ability]:
        return {} if self.settings.object_stiffness is None else {"task.object_stiffness": "materials"}

    def build(self, world: World) -> None:
        self.cubes = [self.object_class(self.settings, world, colour) for colour in self.colours[: self.number]]
        self.cube = self.cubes[0]
        if self.settings.force_penalty is not None:
            self._robot.largest_force()  # starts PyBullet's record of forces

    def apply(self, world: World, name: str, value: float) -> None:
        super().apply(world, name, value)
        for cube in self.cubes:
            if name == "object_mass":
                cube.set_mass(value)
            elif name == "object_friction":
                cube.body.set_friction(value)

    def read(self) -> None:
        for cube in self.cubes:
            cube.read()

    def observe(self) -> list[float]:
        return self.cube.observe(self._robot)

    def lost(self) -> bool:
        return any(cube.lost for cube in self.cubes)

    def let_go(self) -> bool:
        """Whether all cubes are at rest and the robot touched none in the last control step."""
        return all(cube.at_rest and not self._robot.contact_force(cube.body) for cube in self.cubes)

    def extra_reward(self) -> float:
        penalty = self.settings.force_penalty
        return 0.0 if penalty is None else penalty.reward(self._robot.largest_force())


def check_pads(robot: RobotView, task: str, why: str) -> Gripper:
    """The robot's gripper with pads. `why`: its use in the task.

    Raises:
        UsageError: the robot has no gripper, or a suction cup.
    """
    gripper = robot.gripper
    if gripper is None:
        raise UsageError("this robot has no gripper", where=type(robot).__name__, hint=f"{task} {why}")
    if isinstance(gripper, Cup):
        what = f"{task} {why}, which needs pads"
        raise UsageError(what, setting="robot.gripper", hint="choose one with fingers: franka_hand, robotiq_2f85")
    return gripper


def check_gripper(robot: RobotView, task: str, size: float) -> Gripper | Cup:
    """The robot's gripper, checked for an object of `size` m.

    Raises:
        UsageError: the robot has no gripper, or the object is too large or too small for it.
    """
    if isinstance(robot.gripper, Cup):
        if size < 2 * robot.gripper.radius:
            what, least = f"the cup does not seal on a cube of {size:g} m", 2 * robot.gripper.radius
            raise UsageError(what, setting="task.object_size", hint=f"its lip is {least:g} m wide")
        return robot.gripper
    gripper = check_pads(robot, task, "grasps")
    if size > 0.9 * gripper.width:
        raise UsageError(
            f"a cube of {size:g} m does not fit into the gripper",
            setting="task.object_size",
            hint=f"it opens {gripper.width:g} m; a tenth of that is needed as clearance",
        )
    return gripper


def ground(workspace: Box, goals: str, height: float, *, margin: float = 0.0) -> Box:
    """The part of the floor for a cube, with its centre at `height` m, and its goal.

    Args:
        goals: `box`, a square of `GROUND_EDGE` in the middle of the workspace, or `workspace`, all of it.
        margin: distance in m from the edges of the workspace.

    Raises UsageError when the tool cannot be that low, or the margin leaves no room.
    """
    if not workspace.low[2] <= height <= workspace.high[2]:
        raise UsageError(
            f"the tool cannot be {height:g} m above the floor, where the object lies",
            setting="task.object_size",
            hint=f"its workspace is {workspace.low[2]:g} to {workspace.high[2]:g} m high",
        )
    x, y = (workspace.high[axis] - workspace.low[axis] - 2 * margin for axis in (0, 1))
    if min(x, y) <= 0:
        raise UsageError(
            f"no room is left around the object: {margin:g} m are needed on every side of it",
            setting="task.object_size",
            hint=f"the workspace is {x + 2 * margin:.2f} by {y + 2 * margin:.2f} m; take a smaller object",
        )
    box = workspace.middle((x, y, 1.0) if goals == "workspace" else (min(x, GROUND_EDGE), min(y, GROUND_EDGE), 1.0))
    return Box((*box.low[:2], height), (*box.high[:2], height))


def drift(robot: RobotView) -> float:
    """Horizontal distance in m that the tool moves in a control step at its current velocity."""
    return hypot(robot.tool_velocity[0], robot.tool_velocity[1]) * robot.period


def braking(robot: RobotView, target: Vector) -> Vector:
    """A point in m on the way to `target`, so near that the tool slows down before it arrives."""
    x, y, z = (now + BRAKING_SHARE * (goal - now) for now, goal in zip(robot.tool_position, target, strict=True))
    return x, y, z


HOVER_HEIGHT = 0.08
"""Height in m above the cube at which the gripper arrives."""
ALIGNED_DISTANCE = 0.018
"""Distance in m from the cube's axis at which the gripper may go down. Open, it has 1.5 cm to each side of the cube."""
STILL_DRIFT = 0.015
"""Largest horizontal drift of the tool, in m per control step, when it goes down or closes."""
GRIP_HEIGHT = 0.006
"""Height in m above the centre of the cube at which it is gripped, so that the pads do not rub on the floor. There the
fingers would stick and the arm would lag behind."""
CARRYING_CLEARANCE = 0.03
"""Height in m at which the cube moves to a goal on the floor: a dragged cube would twist out of the pads."""
SET_DOWN_GAP = 0.003
"""Height in m at which the cube is held over a goal on the floor: an arm that aims at the floor presses on it."""
OVER = 0.01
"""Distance in m from a goal on another cube, and sideways motion of the tool in m per step, at which it goes down."""
SLOW_SHARE = 0.5
"""Share of the largest speed for going down near a standing cube: arms swing aside when they stop."""
CUP_GAP = 0.001
"""Height in m above the cube at which a cup begins to suck: an arm that aims at the cube would press on it."""
NEAR, NEAR_CUP = 0.006, 0.0007
"""Height in m above the grip at which the gripper closes, or a cup sucks."""
CLOSING_STEPS = 3
"""Control steps in which both pads must touch the cube before it is lifted: before that they centre it."""
GRASP_PATIENCE = 30
"""Control steps after which a gripper that has closed on nothing opens again."""


class CarryTask(CubeTask):
    """The common part of tasks that grip cubes. A task sets `gripper` in `fit`."""

    uses_gripper = True
    gripper: Gripper | Cup

    def _begin(self, cube: Cube, place: Vector, stage: str | None, generator: Generator) -> None:
        """Place a cube there (m): in the gripper (`grasped`), the open gripper around or above it (`near`), or free."""
        if stage == "grasped":
            cube.put_in_gripper(self._robot, self.gripper, place)
        elif stage == "near":
            x, y, z = place
            above = x, y, z + cube.rise(self.gripper) + generator.uniform(GRIP_HEIGHT, HOVER_HEIGHT)
            cube.place_with_tool(self._robot, place, above, 1.0)
        else:
            cube.place(place, aligned(self._robot))


class Carrier:
    """Goes over a cube, goes down, closes, lifts, moves it to its goal and holds it. Restarts if it loses the cube."""

    def __init__(self, robot: RobotView, gripper: Gripper | Cup) -> None:
        self._robot = robot
        self._gripper = gripper
        self._closing = 0
        """Control steps since the gripper began to close; 0 while it is open."""
        self._held = 0
        """Control steps for which the cube has been between the pads."""

    def begin(self, cube: Cube) -> None:
        """Start to work with a cube, which may already be in the hand."""
        self._cube, self._size = cube, 2 * cube.half
        self._rise = cube.rise(self._gripper)
        self._grip_height, self._near = (self._rise + CUP_GAP, NEAR_CUP) if self._rise else (GRIP_HEIGHT, NEAR)
        self.open = 1.0
        """Opening of the gripper for the diagonal of the cube."""
        if isinstance(self._gripper, Gripper):
            self.open = min(1.0, (1.5 * self._size + 0.01) / self._gripper.width)
        self._held = CLOSING_STEPS if self._enclosed() else 0
        self._closing = self._held

    def _enclosed(self) -> bool:
        """Whether the cube is held, or between the pads (its diagonal is 1.42 times its edge)."""
        robot, size = self._robot, self._size
        if isinstance(self._gripper, Cup):
            return robot.pads_touching(self._cube.body) > 0
        near = sum((a - b) ** 2 for a, b in zip(robot.tool_position, self._cube.position, strict=True)) < size**2
        return near and 0.8 * size < robot.opening * self._gripper.width < 1.45 * size

    def act(self, goal: Vector, floor: float = 0.0) -> FloatArray:
        """The next action. `floor`: height in m of objects on the floor; the hand stays above it on its way."""
        robot, (x, y, z), (tx, ty, tz) = self._robot, self._cube.position, self._robot.tool_position
        grip: Vector = (x, y, max(z + self._grip_height, robot.workspace.low[2]))
        if self._closing:
            self._closing += 1
            lifted = self._held > CLOSING_STEPS
            # between the pads, both of which touched it before it was lifted
            held = self._held >= CLOSING_STEPS or robot.pads_touching(self._cube.body) == 2
            self._held = self._held + 1 if self._enclosed() and held else 0
            if self._held > CLOSING_STEPS:
                return robot.towards(self._transport(goal, floor), 0.0)
            if not lifted and self._closing < GRASP_PATIENCE:
                return robot.towards((tx, ty, tz) if self._held else grip, 0.0)
            self._closing = 0
        over = max(floor - self._size, 0.0) + self._rise  # over one cube it comes anyway
        error, above = hypot(tx - x, ty - y), z + over + HOVER_HEIGHT
        high = tz > z + over + HOVER_HEIGHT / 2
        if error > ALIGNED_DISTANCE or (high and drift(robot) > STILL_DRIFT):
            target: Vector = (x, y, above) if high else (tx, ty, above)
            return robot.towards(braking(robot, target), self.open)
        if tz > grip[2] + self._near or drift(robot) > STILL_DRIFT:
            if floor:
                grip = x, y, max(grip[2], tz - SLOW_SHARE / BRAKING_SHARE * robot.tool_step)
            return robot.towards(braking(robot, grip), self.open)
        self._closing = 1
        return robot.towards(grip, 0.0)

    def _transport(self, goal: Vector, floor: float) -> Vector:
        """Position of the tool at which the cube, as it lies in the gripper, is at the goal."""
        robot, tool, cube = self._robot, self._robot.tool_position, self._cube
        x, y, z = (t + g - c for t, g, c in zip(tool, goal, cube.position, strict=True))
        lowest, aside = cube.lowest - floor, hypot(x - tool[0], y - tool[1])
        if aside > CARRYING_CLEARANCE or (floor and max(aside, drift(robot)) > OVER):
            if lowest < CARRYING_CLEARANCE / 3:
                return tool[0], tool[1], tool[2] + CARRYING_CLEARANCE
            z = max(z, tool[2] + CARRYING_CLEARANCE - lowest)
        if floor:
            x, y, _ = braking(robot, (x, y, z))
            z = max(z, tool[2] - SLOW_SHARE * robot.tool_step)
        z = max(z, robot.workspace.low[2], tool[2] + SET_DOWN_GAP - lowest)
        if self._rise and z < tool[2]:  # the cube is pressed between the arm and the place below it
            _, _, z = braking(robot, (x, y, z))
        return x, y, z
