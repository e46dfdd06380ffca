"""Insert: the gripper holds a peg and puts it into a hole with little play."""

from __future__ import annotations

from math import atan2, cos, hypot, pi, sin, sqrt, tan, tanh
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field as Setting

from ..core import Array, BoolArray, Expert, Field, FloatArray, Generator, Layout, Measure, Settings
from ..core.parameters import Drawn, Probability
from ..errors import UsageError
from ..simulation.geometry import Quaternion, Vector, inverse, multiply, rotated, rotation_about, rotation_vector
from ..simulation.interface import Camera, RobotView, Task, World
from ..simulation.shapes import Cuboid, Cylinder, Shape, inertia_of
from .cube import LOST_DISTANCE, aligned, check_pads
from .point_goal import PointGoal
from .settings import ForcePenalty, drawn_stage, seen, start

PEG_COLOUR, BLOCK_COLOUR = (0.93, 0.45, 0.13, 1.0), (0.35, 0.42, 0.5, 1.0)
PEG_LENGTH = 0.06
PEG_WIDTH = {"square": 0.02, "round": 0.016, "connector": 0.016}
"""Edge or diameter of the peg in m: its width between the pads."""
PLUG_LENGTH, RIDGE, RIDGE_WIDTH = 0.024, 0.003, 0.006
"""Sizes of a connector in m: its edge along x, and the height and width of the ridge on its side at +x."""
DEPTH, FLOOR = 0.025, 0.005
"""Depth of the hole and thickness of the floor below it, in m."""
TOP = DEPTH + FLOOR
WALL = 0.02
"""Thickness of the walls around the hole in m."""
SIDES = 32
"""Number of boxes around a round hole. Between them it is wider by R (1 / cos(pi / 32) - 1): .04 mm for R = 8 mm."""
GRIP = 0.02
"""Height in m of the tool above the middle of the peg."""
HOLE_RANGE, HOLE_TURN = 0.05, pi / 4
"""Largest offset of the hole along each axis in m, and largest turn in rad."""
HAND_OFFSET, HAND_TILT = 0.003, 0.05
"""Largest offset in m and tilt in rad of the peg in the hand. Pads centre it in the direction in which they close."""
START_HEIGHT, START_ASIDE = (0.02, 0.05), 0.02
"""Height of the tip over the hole at the start, and its largest distance from the axis along x and y, in m."""
SLACK, TURN_SLACK = 0.001, 0.03
"""Distance of the tip from the axis in m, and turn in rad, that count as in the hole. The play and the error of the
hole are added. At depth they have no effect; they make goals of hindsight as narrow as the hole."""
ALIKE = 0.0005
"""Play in m up to which goals are the same, so that training may sample it: a tight hole alone teaches little."""
SCALES = (0.004, 0.001)
"""Scales in m of additional observations tanh(error / scale): without them networks do not see .1 mm."""
TURN_SCALE = 0.05
"""The same in rad."""
NEAR = (0, 0.0), (1, 0.0), (2, 0.0), (2, DEPTH)
"""Axes of the errors and offsets in m: from the mouth of the hole, and from its bottom."""
TOUCH, TOUCH_SCALES = Layout((Field("touch", 4),)), (5.0, 0.01, 0.01, 0.05)
"""Field that is also observed if the hole is not known exactly, and its scales in N, m, m and N m."""


class Insertion(PointGoal):
    """Success if the tip is deep enough and turned like the hole, and no force was too large.

    `achieved` (..., 7): the tip from the mouth of the hole (3, m), the peg's turn to the nearest position that fits (3,
    rotation vector, rad), and 1 once a force exceeded the limit. `desired` (..., 6) the same without the last. Reward 0
    on success, else -1.

    Args:
        tolerance: of the depth, in m.
        aside: largest distance of the tip from the axis, in m.
        turn: largest angle of the turn, in rad.
    """

    place = slice(3)

    def __init__(self, tolerance: float, aside: float, turn: float) -> None:
        super().__init__(tolerance, dense=False, span=1.0)
        self.aside, self.turn = aside, turn

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        off = np.abs(achieved[..., :6] - desired)
        aside, turn = np.hypot(off[..., 0], off[..., 1]), np.vecdot(off[..., 3:], off[..., 3:])
        there = (off[..., 2] < self.threshold) & (aside < self.aside) & (turn < self.turn**2)
        whole: BoolArray = there & (achieved[..., 6] == 0)
        return whole


class Insert(Task):
    """What to do: put the peg in the hand into the hole, to within 1 mm of its depth of 25 mm, with little force.

    What is randomised: the hole, within 5 cm of the middle of the workspace along each axis and turned by up to 45
    degrees; the peg in the hand, by up to 3 mm along the pads and upwards and tilted by up to 3 degrees; the start, 2
    to 5 cm above the hole and up to 2 cm off its axis. `hole_error` and `hole_turn_error` bound the error of the known
    hole, sampled once per episode. With probability `start_inserted` an episode begins with the peg partly in the hole.
    Of the others `start_near` begin on the way from there to a usual start. Training may sample these parameters.

    Observation, along the world's axes: tip_from_hole (3, m, from the middle of the mouth of the hole as it is known),
    peg_turn (3, rad, the rotation vector to the nearest position that fits), tip_velocity (3, m/s),
    peg_angular_velocity (3, rad/s), near_errors (11, tanh of the errors at fine scales), peg_wrench (6, N and N m: the
    wrist's), overloaded (1, whether a force was too large); if the hole is not known exactly also touch (4, tanh of
    the force on the tip from below, of the place of its middle from the tip along x and y, and of the torque about the
    vertical, at fine scales). Only for critics: hole_error (3, m and rad: error of the known hole), peg_forces (2, N:
    largest on the peg and on the arm).
    Action: the robot's, without the gripper: it stays closed around the peg.
    Goals: achieved, the tip from the hole as it is known (3, m), the peg's turn (3, rad) and whether a force was too
    large (1); desired, the bottom of the hole and no turn (6).
    Reward: sparse -1 until the peg is in, then 0; less if a force exceeds that of `force_penalty`.
    What counts as success: the tip within 1 mm of the depth, in the hole, and never a force above `force_limit`.
    Termination: never; the episode is truncated after `max_steps`.
    """

    class Settings(Settings):
        shape: Literal["square", "round", "connector"] = Setting(
            "square",
            description="of peg and hole; square: 20 x 20 mm; round: diameter 16 mm; connector: a plug of 24 x 16 mm "
            "with a ridge, which fits in one orientation only",
        )
        play: float = Setting(0.0005, gt=0, le=0.01, description="width of the hole minus width of the peg, m")
        chamfer: float = Setting(0.001, ge=0, le=0.005, description="height and width of the hole's chamfer, m")
        hole_error: Annotated[float, Drawn("m", 0.0, 0.0)] = Setting(
            0.0,
            ge=0,
            le=0.005,
            description="largest error of the known hole position along x and y, m; randomization samples up to it",
        )
        hole_turn_error: Annotated[float, Drawn("rad", 0.0, 0.0)] = Setting(
            0.0, ge=0, le=0.1, description="largest error of its known turn, rad; randomization samples up to it"
        )
        peg_mass: Annotated[float, Drawn("kg", 0.02, 1.0)] = Setting(0.1, gt=0, le=1, description="mass of the peg, kg")
        friction: Annotated[float, Drawn("1", 0.0, 2.0)] = Setting(
            0.3, ge=0, le=2, description="lateral friction coefficient between peg and block"
        )
        force_limit: Annotated[float, Drawn("N", 1.0, 10_000.0)] = Setting(
            50.0, gt=0, description="largest force on peg or arm, N; more fails the episode"
        )
        force_penalty: ForcePenalty | None = Setting(
            ForcePenalty.model_validate({"limit": 15.0, "weight": 2.0, "most": 5.0}),
            description="cost of the largest force on peg or arm, without the grip; null: none",
        )
        start_inserted: Probability = start("the peg partly in the hole")
        start_near: Probability = start("the peg between the hole and the usual start")
        max_steps: int = Setting(100, ge=1, le=100_000, description="control steps per episode")

    settings: Settings
    drawn: Settings
    uses_gripper = "closed"
    control = "impedance"
    camera = Camera(target=(0.5, 0.0, 0.07), distance=0.55)
    observation = Layout(
        (
            Field("tip_from_hole", 3, "m", kind="vector"),
            Field("peg_turn", 3, "rad", kind="axial"),
            Field("tip_velocity", 3, "m/s", kind="vector"),
            Field("peg_angular_velocity", 3, "rad/s", kind="axial"),
            Field("near_errors", 11, kind=("vector", "scalar", "vector", "scalar", "axial")),
            Field("peg_wrench", 6, "N, N m", kind="wrench"),
            Field("overloaded", 1, kind="scalar"),
        )
    )
    fine_fields = {  # noqa: RUF012
        "near_errors": [
            *(("tip_from_hole", axis, offset, scale) for scale in SCALES for axis, offset in NEAR),
            *(("peg_turn", axis, 0.0, TURN_SCALE) for axis in range(3)),
        ]
    }
    critic_only = Layout((Field("hole_error", 3, "m, rad"), Field("peg_forces", 2, "N")))
    measures = (
        Measure(
            "insertion_force", "N", "smaller", "largest force of the block on the peg or of anything else on the arm"
        ),
    )
    distance_measure = Measure("final_distance", "m", "smaller", "distance of the tip from the bottom of the hole")
    desired_goal = Layout((Field("tip_from_hole", 3, "m", kind="vector"), Field("peg_turn", 3, "rad", kind="axial")))
    achieved_goal = desired_goal + Layout((Field("overloaded", 1, kind="scalar"),))

    def __init__(self, settings: Insert.Settings) -> None:
        super().__init__(settings)
        self.width = PEG_WIDTH[settings.shape]
        self.blind = max(settings.hole_error, settings.hole_turn_error) > 0
        if self.blind:
            self.observation = type(self).observation + TOUCH
        play = max(settings.play, ALIKE)
        aside = SLACK + play + sqrt(2) * settings.hole_error
        turn = TURN_SLACK + play / DEPTH + 2 * play / self.width + settings.hole_turn_error
        self.goal_rule = Insertion(0.001, aside, turn)
        self.goal = np.array((0.0, 0.0, -DEPTH, 0.0, 0.0, 0.0), np.float32)
        if settings.force_penalty is not None:
            self.extra_reward_range = -settings.force_penalty.most, 0.0

    def fit(self, robot: RobotView) -> None:
        self._robot = robot
        self._opening = self.width / check_pads(robot, type(self).__name__, "holds a peg").width
        self.held_mass = self.settings.peg_mass
        if self._opening > 0.9:
            what = f"a peg of {self.width:g} m does not fit into the gripper"
            raise UsageError(what, setting="robot.gripper", hint="choose one that opens wider, or another task.shape")
        if self.settings.shape != "round" and not (robot.orientations.tilt or robot.turns_joints):
            what = "these actions do not turn the tool, and the hole is turned"
            raise UsageError(what, setting="robot.control", hint="set robot.control: impedance, or task.shape: round")
        box, inserted = robot.workspace, TOP - DEPTH + PEG_LENGTH / 2 + GRIP
        if not box.low[2] <= inserted <= box.high[2]:
            what = f"the tool cannot be {inserted:g} m above the floor, where the peg is in the hole"
            raise UsageError(what, setting="task", hint=f"its workspace is {box.low[2]:g} to {box.high[2]:g} m high")
        self.middle = box.centre[:2]

    def build(self, world: World) -> None:
        self.world = world
        self.block = world.body(block(self.settings), 0.0, BLOCK_COLOUR)
        self.peg = world.body(peg(self.settings.shape), self.settings.peg_mass, PEG_COLOUR)
        self.block.set_friction(self.settings.friction)
        self.peg.set_friction(1.0)
        world.forces(self.peg)  # starts the record of forces
        self._robot.largest_force()

    def apply(self, world: World, name: str, value: float) -> None:
        super().apply(world, name, value)
        if name == "friction":
            self.block.set_friction(value)
        elif name == "peg_mass":
            a, b, c = inertia_of(peg(self.settings.shape), value).moments
            self.peg.set_inertia(value, (a, b, c))

    def reset(self, generator: Generator) -> None:
        settings = self.settings
        self._closing = self._robot.closing
        self._upright = self._gripped()
        x, y, turn = generator.uniform(-1, 1, 3).tolist()
        hole: Vector = (self.middle[0] + HOLE_RANGE * x, self.middle[1] + HOLE_RANGE * y, TOP)
        turn *= HOLE_TURN
        along, up, tilt = (generator.uniform(-1, 1, 3) * (HAND_OFFSET, HAND_OFFSET, HAND_TILT)).tolist()
        aside, height = generator.uniform(-1, 1, 3).tolist(), generator.uniform()
        stage = self.stage = drawn_stage(self.drawn, generator.uniform(), "inserted", "near")
        if stage == "inserted":
            tilt, turned, room = 0.0, turn, 0.4 * settings.play
            tip = room * aside[0], room * aside[1], -DEPTH * height
        elif stage == "near":
            (share, missing), (low, high) = generator.uniform(size=2).tolist(), START_HEIGHT
            tilt, turned, beside = share * tilt, (1 - missing) * turn, share * START_ASIDE
            tip = beside * aside[0], beside * aside[1], share * (low + (high - low) * height)
        else:
            low, high = START_HEIGHT
            turned, tip = 0.0, (START_ASIDE * aside[0], START_ASIDE * aside[1], low + (high - low) * height)
        self._hold(_sum(hole, tip), turned, along, up, tilt)
        yaw = _yaw(self._upright)
        self.block.place((hole[0], hole[1], 0.0), _about_z(yaw + turn))
        known, turned = self.drawn.hole_error, self.drawn.hole_turn_error
        errors = generator.uniform(-1, 1, 3) * (known, known, turned)
        self.hole_error: list[float] = errors.tolist()
        self.known: Vector = (hole[0] + errors[0], hole[1] + errors[1], TOP)
        self.known_yaw = yaw + turn + errors[2]
        self.overloaded, self.largest = False, 0.0
        self.forces = [0.0, 0.0]
        self._read()

    def _gripped(self) -> Quaternion:
        """The upright rotation of the peg between the pads at home: their sides of a connector are those along x."""
        upright = aligned(self._robot)
        if self.settings.shape != "connector":
            return upright
        x, y, _ = rotated(inverse(upright), self._closing)
        return upright if abs(y) > abs(x) else multiply(_about_z(pi / 2), upright)

    def _hold(self, tip: Vector, turn: float, along: float, up: float, tilt: float) -> None:
        """Place the tool with the peg so that the tip is there, at rest.

        Args:
            tip: in m.
            turn: of the tool from home about the vertical, rad.
            along: offset in m of the peg in the hand along the pads.
            up: offset in m of the peg in the hand upwards.
            tilt: of the peg in the hand about the direction in which pads close, rad.
        """
        robot, turned = self._robot, _about_z(turn)
        along_x, along_y, _ = rotated(turned, self._closing)
        tilted = rotation_about((tilt * along_x, tilt * along_y, 0.0))
        offset = -along * along_y, along * along_x, 0.0
        middle = _sum(offset, rotated(tilted, (0.0, 0.0, up - GRIP)))
        bottom = _sum(middle, rotated(tilted, (0.0, 0.0, -PEG_LENGTH / 2)))
        tool = _sum(tip, bottom, sign=-1)
        robot.place_tool(tool, self._opening, orientation=multiply(turned, robot.orientations.middle), closing=True)
        self.peg.place(_sum(tool, middle), multiply(tilted, multiply(turned, self._upright)))

    def read(self) -> None:
        self._read()
        self.forces = [
            self.world.forces(self.peg).get((-1, self.block.index), 0.0),
            self._robot.largest_force(self.peg),
        ]
        self.largest = max(self.largest, *self.forces)
        self.overloaded = self.largest > self.drawn.force_limit

    def _read(self) -> None:
        position, self.rotation = self.peg.pose()
        self.velocity, self.spin = self.peg.velocity()
        arm = rotated(self.rotation, (0.0, 0.0, -PEG_LENGTH / 2))
        self.tip = _sum(position, arm)
        self.tip_velocity = _sum(self.velocity, _cross(self.spin, arm))

    @property
    def tip_from_hole(self) -> Vector:
        """The vector from the mouth of the known hole to the tip, m, along the world's axes."""
        return _sum(self.tip, self.known, sign=-1)

    @property
    def target(self) -> Quaternion:
        """The nearest rotation of the peg that fits into the known hole."""
        yaw, shape = _yaw(self.rotation), self.settings.shape
        if shape == "square":
            yaw += (self.known_yaw - yaw + pi / 4) % (pi / 2) - pi / 4
        return _about_z(self.known_yaw if shape == "connector" else yaw)

    @property
    def turn(self) -> Vector:
        """The rotation vector in rad from the peg's rotation to `target`."""
        return rotation_vector(multiply(self.target, inverse(self.rotation)))

    def observe(self) -> list[float]:
        place = seen(self._robot, self.tip_from_hole)
        values = self._robot.with_noise([*place, *self.turn, *self.tip_velocity, *self.spin])
        near = [tanh((values[axis] + offset) / scale) for scale in SCALES for axis, offset in NEAR]
        near += [tanh(error / TURN_SCALE) for error in values[3:6]]
        rotation, wrench = self._robot.tool.orientation, self._robot.wrench
        felt = [*rotated(rotation, wrench[:3]), *rotated(rotation, wrench[3:])]
        touch = zip(self.touch(), TOUCH_SCALES, strict=True) if self.blind else ()
        return [*values, *near, *felt, float(self.overloaded), *(tanh(value / scale) for value, scale in touch)]

    def touch(self) -> tuple[float, float, float, float]:
        """The wrist's wrench at the tip: force from below (N), its place (x and y in m), torque about z (N m)."""
        tool, wrench = self._robot.tool, self._robot.wrench
        force, arm = rotated(tool.orientation, wrench[:3]), _sum(self.tip, tool.position, sign=-1)
        up, (x, y, z) = force[2], _sum(rotated(tool.orientation, wrench[3:]), _cross(arm, force), sign=-1)
        return (up, -y / up, x / up, z) if up > 0 else (up, 0.0, 0.0, z)

    def observe_for_critics(self) -> list[float]:
        return [*self.hole_error, *self.forces]

    def achieved(self) -> FloatArray:
        return np.array((*self.tip_from_hole, *self.turn, self.overloaded), np.float32)

    def extra_reward(self) -> float:
        penalty = self.settings.force_penalty
        return 0.0 if penalty is None else penalty.reward(max(self.forces))

    def measure(self) -> dict[str, float]:
        return {"insertion_force": self.largest}

    def lost(self) -> bool:
        return not hypot(*self.tip) < LOST_DISTANCE

    def expert(self) -> Expert:
        return InsertExpert(self._robot, self)


CLEARANCE = 0.004
"""Height in m of the tip above the mouth before it is over it."""
OVER, STRAIGHT = 0.0015, 0.02
"""Largest distance from the known axis in m, and largest turn of the peg in rad, at which the tip goes down."""
FAST, RATE, LEAD = 0.06, 2.0, 0.1
"""Largest speed downwards in m/s, speed per m of distance to mouth or bottom, time in s for errors of the speed."""
PRESSING, STUCK = 0.003, 0.006
"""Depth in m of the set point below a resting tip, and speed in m/s below which a sinking tip rests."""
RIM = 0.0002
"""Depth in m below the chamfer down to which the tip may still rest on it."""
ASIDE, FURTHEST = 0.2, 0.003
"""Sideways shift of the set point per m of the pressure's offset to the other side, and the largest shift in m."""
TURNING, TURNING_INSIDE, MOST_TURN = 0.2, 0.05, 0.015
"""Turn of the set point in rad per N m about the vertical, the same in the hole, and the largest turn."""


class InsertExpert(Expert):
    """Goes over the hole, straightens the peg, goes down, and from the mouth on follows the forces.

    The rim presses a resting peg from below on the side away from the hole, so it moves to the other side. The chamfer
    turns a resting peg towards the position that fits. Each action depends only on the current step.
    """

    def __init__(self, robot: RobotView, task: Insert) -> None:
        self._robot, self._task = robot, task

    def act(self) -> FloatArray:
        task, tool, period = self._task, self._robot.tool, self._robot.period
        x, y, z = task.tip_from_hole
        turn = task.turn
        straight = hypot(*turn) < STRAIGHT
        if z > CLEARANCE / 2 and not (straight and hypot(x, y) < OVER):
            tip = _sum(task.known, (0.0, 0.0, max(z, CLEARANCE)))
        else:
            side, sinks = (-x, -y), -task.tip_velocity[2]
            wanted = min(FAST, RATE * (z if z > 0 else max(z + DEPTH, 0.0)))
            ahead = max(wanted * period + LEAD * (wanted - sinks), 0.0)
            if z < CLEARANCE / 2:
                _, east, north, about = task.touch()
                rim = z > -task.settings.chamfer - RIM
                share = min(ASIDE, FURTHEST / max(hypot(east, north), 1e-9)) if rim else 0.0
                side = -share * east, -share * north
                turned = (TURNING if rim else TURNING_INSIDE) * about
                turn = turn[0], turn[1], min(max(turned, -MOST_TURN), MOST_TURN)
                ahead = PRESSING if sinks < STUCK else ahead
            tip = _sum(task.tip, (*side, max(-ahead, -DEPTH - PRESSING - z)))
        rotation = rotation_about(turn)
        place = _sum(tip, rotated(rotation, _sum(task.tip, tool.position, sign=-1)), sign=-1)
        return self._robot.towards(place, 0.0, multiply(rotation, tool.orientation))


def block(settings: Insert.Settings) -> list[Shape]:
    """A block with a hole, made of boxes: its bottom is at z = 0, the middle of the hole at x = y = 0."""
    chamfer = settings.chamfer
    deep, above, rim = _sides(settings, 0.0, WALL), _sides(settings, chamfer, WALL), _sides(settings, chamfer, 0.0)
    outside = 2 * (max(side.inner for side in deep) + WALL)
    shapes: list[Shape] = [Cuboid((outside, outside, FLOOR), position=(0.0, 0.0, FLOOR / 2))]
    for low, high, edge in zip(deep, above, rim, strict=True):
        if low.length:
            shapes.append(_wall(low, FLOOR, TOP - chamfer))
            if chamfer:
                shapes.append(_wall(high, TOP - chamfer, TOP))
        if chamfer:
            depth = WALL / 4
            out = low.inner + chamfer / 2 + depth / 2 * sqrt(0.5)
            place = out, edge.along, TOP - chamfer / 2 - depth / 2 * sqrt(0.5)
            leaning = multiply(edge.turn, rotation_about((0.0, pi / 4, 0.0)))
            size = depth, edge.length, chamfer * sqrt(2)
            shapes.append(Cuboid(size, position=rotated(edge.turn, place), orientation=leaning))
    return shapes


def peg(shape: str) -> list[Shape]:
    """The upright peg with its middle at the origin. A connector has its ridge at +x."""
    width = PEG_WIDTH[shape]
    if shape == "round":
        return [Cylinder(width / 2, PEG_LENGTH)]
    if shape == "square":
        return [Cuboid((width, width, PEG_LENGTH))]
    ridge = Cuboid((RIDGE, RIDGE_WIDTH, PEG_LENGTH), position=((PLUG_LENGTH + RIDGE) / 2, 0.0, 0.0))
    return [Cuboid((PLUG_LENGTH, width, PEG_LENGTH)), ridge]


class _Face(NamedTuple):
    """A side of a hole: a line as seen from above."""

    turn: Quaternion
    """Angle from the x axis to the direction out of the hole."""
    inner: float
    """Distance of the line from the middle of the hole, m."""
    along: float
    """Position of its middle along the line, m."""
    length: float
    """Length in m."""


def _sides(settings: Insert.Settings, wider: float, wall: float) -> list[_Face]:
    """The sides of a hole.

    Args:
        wider: distance in m by which each side is further out: the width of the chamfer.
        wall: thickness in m of walls behind the sides. The walls are longer and meet at the outer corners. A side
            without a wall of its own then has no length.
    """
    half = (PEG_WIDTH[settings.shape] + settings.play) / 2 + wider
    if settings.shape != "connector":
        count = 4 if settings.shape == "square" else SIDES
        length = 2 * (half + wall) * tan(pi / count)
        return [_Face(_about_z(2 * pi * side / count), half, 0.0, length) for side in range(count)]
    end, key = (PLUG_LENGTH + settings.play) / 2 + wider, (RIDGE_WIDTH + settings.play) / 2 + wider
    found = [
        _Face(_about_z(pi), end, 0.0, 2 * (half + wall)),
        _Face(_about_z(0.0), end + RIDGE, 0.0, 2 * (key + wall)),
    ]
    for sign in (1, -1):
        aside = _about_z(sign * pi / 2)
        found += [
            _Face(aside, half, 0.0, 2 * (end + wall)),
            _Face(_about_z(0.0), end, sign * (key + half + wall) / 2, half + wall - key),  # next to the keyway
            _Face(
                aside, key, -sign * (end + RIDGE / 2), 0.0 if wall else RIDGE
            ),  # in the keyway, whose wall is the one before
        ]
    return found


def _wall(side: _Face, low: float, high: float) -> Shape:
    """The wall behind a side, between two heights in m."""
    size = WALL, side.length, high - low
    place = side.inner + WALL / 2, side.along, (low + high) / 2
    return Cuboid(size, position=rotated(side.turn, place), orientation=side.turn)


def _sum(first: Vector, second: Vector, *, sign: float = 1.0) -> Vector:
    return first[0] + sign * second[0], first[1] + sign * second[1], first[2] + sign * second[2]


def _cross(first: Vector, second: Vector) -> Vector:
    (a, b, c), (x, y, z) = first, second
    return b * z - c * y, c * x - a * z, a * y - b * x


def _about_z(angle: float) -> Quaternion:
    return 0.0, 0.0, sin(angle / 2), cos(angle / 2)


def _yaw(rotation: Quaternion) -> float:
    """Angle of the x axis about the vertical."""
    x, y, _ = rotated(rotation, (1.0, 0.0, 0.0))
    return atan2(y, x)
