"""Open: the closed gripper hooks the handle of a drawer or a door and brings it to a position, open or closed."""

from __future__ import annotations

from dataclasses import replace
from math import cos, hypot, pi, sin
from typing import Annotated, Literal

import numpy as np
from pydantic import Field as Setting

from ..core import Array, BoolArray, Expert, Field, FloatArray, Generator, Layout
from ..core import Settings as BaseSettings
from ..core.parameters import Drawn, Probability
from ..simulation.geometry import Vector
from ..simulation.interface import Camera, RobotView, Task, World
from ..simulation.parts import Link, mechanism
from ..simulation.shapes import Cuboid, Shape, inertia_of
from .cube import braking, drift
from .point_goal import GOAL_COLOUR, PointGoal, sample_position
from .settings import ForcePenalty, drawn_stage, seen, start

PIECE_COLOUR, FRONT_COLOUR = (0.35, 0.42, 0.5, 1.0), (0.93, 0.45, 0.13, 1.0)
TRAVEL, ANGLE = 0.15, pi / 2
"""Travel of the drawer in m, and of the door in rad."""
WIDTH, DEPTH, TOP, BOARD = 0.18, 0.16, 0.06, 0.016
"""Sizes of the piece, and thickness of its boards, in m. It is too low to touch a hand at the handle."""
BAR = 0.012
"""Thickness of the bar of the handle in m. With its two legs it encloses a square in front of drawer or door."""
BAR_HEIGHT, GRIP = 0.05, 0.045
"""Height of the bar, and of the tool behind it, in m."""
HINGE_DISTANCE = 0.13
"""Distance in m from the hinge of the door to its handle, along the door."""
PLACE, TURN, MARGIN = (0.08, 0.16, 0.0), pi / 4, 0.01
"""Edges in m of the box for the middle of the handle's way, largest turn of the piece away from the robot in rad, and
distance in m of that way from the edges of the workspace."""
NEAR = 0.08
"""Largest height in m above the handle of a start near it."""


class JointGoal(PointGoal):
    """Success if a joint is near its goal, in m or rad.

    `achieved` and `desired` (..., 4): the position of the joint and that of the handle (3, m), which follows from it.
    """

    place = slice(1, None)

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        near: BoolArray = np.abs(achieved[..., 0] - desired[..., 0]) < self.threshold
        return near


class HingeGoal(JointGoal):
    """The same for a turning joint, whose position is an angle."""

    def angle(self, achieved: Array, desired: Array) -> FloatArray:
        off: FloatArray = np.abs(achieved[..., 0] - desired[..., 0])
        return off


class Open(Task):
    """What to do: bring a drawer to within 1 cm of a position, or a door to within 3 degrees, by its handle.

    A drawer moves by 15 cm, a door turns by 90 degrees. A handle is a bar on two legs. A closed gripper that points
    down moves it from behind. The goal may be more or less open than the start.

    What is randomised: the middle of the handle's way, in a box of 8 by 16 cm in the middle of the workspace; the
    direction of the piece, up to 45 degrees away from the robot; the position of the joint at the start and in the
    goal, uniformly over its range. With probability `start_hooked` an episode begins with the tool behind the bar. The
    others begin with probability `start_near` with the tool there or up to 8 cm above. Training may sample these
    parameters.

    Observation: handle_position (3, m), handle_direction (2, where it moves when the piece opens), handle_speed (1, m/s
    along it), joint_position (1, m or rad), handle_from_tool (3, m).
    Action: the robot's, without the gripper.
    Goals: achieved and desired, the position of the joint (1, m or rad) and that of the handle (3, m).
    Reward: sparse -1 until the goal is reached, then 0; dense minus the distance of the handle in m.
    What counts as success: the joint lies within `threshold` of the goal, that of a door within `angle_threshold`.
    Termination: never; the episode is truncated after `max_steps`.
    """

    class Settings(BaseSettings):
        mechanism: Literal["drawer", "door"] = Setting("drawer", description="fixture to open and close")
        reward: Literal["sparse", "dense"] = Setting(
            "sparse", description="-1 until success, or minus the distance in m"
        )
        threshold: float = Setting(0.01, gt=0, le=0.05, description="distance at which a drawer's goal is reached, m")
        angle_threshold: float = Setting(
            pi / 60, gt=0, le=0.5, description="angle at which a door's goal is reached, rad; default: 3 degrees"
        )
        handle_width: float = Setting(
            0.07, ge=0.04, le=0.1, description="space behind the bar of the handle: edge of a square, m"
        )
        friction: Annotated[float, Drawn("1", 0.0, 3.0)] = Setting(
            0.5, ge=0, le=5, description="lateral friction coefficient of drawer or door and handle"
        )
        mass: Annotated[float, Drawn("kg", 0.2, 5.0)] = Setting(
            1.0, gt=0, le=20, description="mass of the moving part, kg"
        )
        joint_friction: Annotated[float, Drawn("N", 0.0, 20.0)] = Setting(
            3.0, ge=0, le=50, description="dry friction of the joint, as a force at the handle, N"
        )
        joint_damping: Annotated[float, Drawn("N s/m", 0.0, 50.0)] = Setting(
            5.0, ge=0, le=200, description="viscous friction of the joint, at the handle, N s/m"
        )
        force_penalty: ForcePenalty | None = Setting(
            None, description="cost of the largest force on a link of arm or gripper; null: none"
        )
        start_hooked: Probability = start("the tool behind the bar of the handle")
        start_near: Probability = start("the tool behind the bar of the handle or above it")
        max_steps: int = Setting(50, ge=1, le=100_000, description="control steps per episode")

    settings: Settings
    drawn: Settings
    goal_rule: JointGoal
    uses_gripper = False
    protective_stop = False  # a tool that hits the bar at full speed presses with 200 N, and must learn not to
    camera = Camera(target=(0.5, 0.0, 0.08), distance=1.2)
    observation = Layout(
        (
            Field("handle_position", 3, "m", kind="point"),
            Field("handle_direction", 2, kind="vector"),
            Field("handle_speed", 1, "m/s", kind="scalar"),
            Field("joint_position", 1, "m, rad", kind="scalar"),
            Field("handle_from_tool", 3, "m", kind="vector"),
        )
    )
    achieved_goal = desired_goal = Layout(
        (Field("joint_position", 1, "m, rad", kind="scalar"), Field("handle_position", 3, "m", kind="point"))
    )

    def __init__(self, settings: Open.Settings) -> None:
        super().__init__(settings)
        self.turns = settings.mechanism == "door"
        self.range = ANGLE if self.turns else TRAVEL
        self.handle = BOARD / 2 + settings.handle_width / 2, HINGE_DISTANCE if self.turns else 0.0
        """Its x and y in m from the middle of the front or from the hinge, when closed. It opens along x."""
        self.lever = hypot(*self.handle) if self.turns else 1.0
        """Way of the handle in m per m or rad of the joint."""
        if self.turns:  # its hinge is on one side: the mirror image is another door
            self.observation = Layout(tuple(replace(field, kind=None) for field in self.observation.fields))
        dense = settings.reward == "dense"
        rule, threshold = (HingeGoal, settings.angle_threshold) if self.turns else (JointGoal, settings.threshold)
        self.goal_rule = rule(threshold, dense=dense, span=1.0)
        if settings.force_penalty is not None:
            self.extra_reward_range = -settings.force_penalty.most, 0.0

    def fit(self, robot: RobotView) -> None:
        self._robot = robot
        self.places = robot.workspace.middle(PLACE)

    def build(self, world: World) -> None:
        shapes = self._front()
        front = Link(
            name="front",
            shapes=shapes,
            mass=1.0,
            colour=FRONT_COLOUR,
            parent="piece",
            joint="hinge" if self.turns else "slide",
            axis=(0.0, 0.0, -1.0) if self.turns else (1.0, 0.0, 0.0),
            range=(0.0, self.range),
        )
        self.inertia = inertia_of(shapes, 1.0).moments
        """Principal moments of 1 kg, in kg m2."""
        self.piece = world.load(mechanism([_body(WIDTH / 2 if self.turns else 0.0), front]))
        self.link = self.piece.links()["front"]
        self._marker = world.marker(0.02, GOAL_COLOUR)
        for name in ("mass", "friction", "joint_friction", "joint_damping"):
            self.apply(world, name, getattr(self.settings, name))
        if self.settings.force_penalty is not None:
            self._robot.largest_force()  # starts PyBullet's record of forces

    def _front(self) -> list[Shape]:
        """The drawer or the door with its handle, closed. The middle of the drawer's front or the hinge is at 0."""
        inner, (x, y), middle = self.settings.handle_width, self.handle, WIDTH / 2 if self.turns else 0.0
        legs = [
            Cuboid((inner, BAR, BAR), position=(x, y + sign * (inner + BAR) / 2, BAR_HEIGHT)) for sign in (-1.0, 1.0)
        ]
        bar = Cuboid((BAR, inner + 2 * BAR, BAR), position=(x + (inner + BAR) / 2, y, BAR_HEIGHT))
        plate = Cuboid((BOARD, WIDTH, TOP - 0.01), position=(0.0, middle, (TOP + 0.01) / 2))
        tray = Cuboid((DEPTH - 2 * BOARD, WIDTH - 3 * BOARD, TOP / 2), position=(-DEPTH / 2, 0.0, TOP / 2))
        return [plate, bar, *legs] if self.turns else [plate, bar, *legs, tray]

    def apply(self, world: World, name: str, value: float) -> None:
        super().apply(world, name, value)
        if name == "mass":
            a, b, c = self.inertia
            self.piece.set_inertia(value, (value * a, value * b, value * c), self.link)
        elif name == "friction":
            self.piece.set_friction(value, self.link)
        elif name == "joint_friction":
            self.piece.drive_joint("front", 0.0, value * self.lever)
        elif name == "joint_damping":
            self.piece.set_joint_damping("front", value * self.lever**2)

    def reset(self, generator: Generator) -> None:
        self.yaw = pi + generator.uniform(-TURN, TURN)
        self._stand(
            sample_position(generator, self.places, "the handle with all of its way in the workspace", self._fits)
        )
        self.piece.place((*self.origin, 0.0), (0.0, 0.0, sin(self.yaw / 2), cos(self.yaw / 2)))
        begin, goal = generator.uniform(0.0, self.range, 2).tolist()
        while abs(goal - begin) < self.goal_rule.threshold:
            goal = generator.uniform(0.0, self.range)
        self.piece.place_joint("front", begin)
        stage = self.stage = drawn_stage(self.drawn, generator.uniform(), "hooked", "near")
        above = generator.uniform(0.0, NEAR)
        x, y, z = self.handle_at(begin)
        if stage:
            self._robot.place_tool((x, y, z + above * (stage == "near")), 0.0)
        self.goal = np.array((goal, *self.handle_at(goal)), np.float32)
        self._marker.place(self.handle_at(goal))
        self.read()

    def _stand(self, middle: FloatArray) -> None:
        """Place the piece so that the middle of the handle's way is there, in m."""
        self.origin = 0.0, 0.0
        x, y, _ = np.subtract(middle, self.handle_at(self.range / 2)).tolist()
        self.origin = x, y

    def _fits(self, middle: FloatArray) -> bool:
        """Whether the handle stays in the workspace if the middle of its way is there."""
        self._stand(middle)
        way = (self.handle_at(share * self.range) for share in (0.0, 0.25, 0.5, 0.75, 1.0))
        return all(self._robot.workspace.contains(point, -MARGIN) for point in way)

    def handle_at(self, position: float) -> Vector:
        """Place in m where a tool hooks the handle, at a position of the joint."""
        (x, y), turned = self.handle, self.yaw - position if self.turns else self.yaw
        x, a, b = x if self.turns else x + position, cos(turned), sin(turned)
        return self.origin[0] + a * x - b * y, self.origin[1] + b * x + a * y, GRIP

    def direction_at(self, position: float) -> tuple[float, float]:
        """Direction of the handle's motion when the joint opens: a unit vector along the floor."""
        (x, y), turned = self.handle, self.yaw - position if self.turns else self.yaw
        across, along = (-x / self.lever, y / self.lever) if self.turns else (0.0, 1.0)
        return cos(turned) * along - sin(turned) * across, sin(turned) * along + cos(turned) * across

    def read(self) -> None:
        self.position, self.speed = self.piece.joint("front")

    def observe(self) -> list[float]:
        values = [*seen(self._robot, self.handle_at(self.position)), *self.direction_at(self.position)]
        values = self._robot.with_noise([*values, self.lever * self.speed, self.position])
        return values + [own - tool for own, tool in zip(values, self._robot.observed_tool_position, strict=False)]

    def achieved(self) -> FloatArray:
        return np.array((self.position, *self.handle_at(self.position)), np.float32)

    def extra_reward(self) -> float:
        penalty = self.settings.force_penalty
        return 0.0 if penalty is None else penalty.reward(self._robot.largest_force())

    def lost(self) -> bool:
        return not abs(self.position) < 10.0

    def expert(self) -> Expert:
        return OpenExpert(self._robot, self)


HOVER = 0.055
"""Height in m above the handle at which the tool arrives."""
ALIGNED = 0.01
"""Distance in m from the middle of the handle's square at which the tool goes down."""
AHEAD, GAIN, SLOWING = 0.008, 1.5, 0.6
"""Distance in m that the tool aims ahead on the handle's way while the handle rests; additional distance per m that the
handle moves in a control step; and the largest share of the way to the goal that it aims ahead."""
DONE = 0.3
"""Fraction of the threshold at which the handle is left alone."""


class OpenExpert(Expert):
    """Goes over the handle, down behind its bar, and along its way. Restarts when it has left the bar."""

    def __init__(self, robot: RobotView, task: Open) -> None:
        self._robot, self._task = robot, task

    def act(self) -> FloatArray:
        robot, task = self._robot, self._task
        (x, y, z), (tx, ty, tz) = task.handle_at(task.position), robot.tool_position
        beside = hypot(tx - x, ty - y)
        if beside > task.settings.handle_width / 2 or tz > z + BAR:
            high = tz > z + 0.8 * HOVER
            if beside < ALIGNED and (not high or drift(robot) < ALIGNED):
                target: Vector = (x, y, z)
            else:
                target = (x, y, z + HOVER) if high else (tx, ty, z + HOVER)
            return robot.towards(braking(robot, target), 0.0)
        error = (float(task.goal[0]) - task.position) * task.lever
        most = AHEAD + GAIN * abs(task.speed) * task.lever * robot.period
        ahead = 0.0 if abs(error) < DONE * task.goal_rule.threshold * task.lever else SLOWING * error
        ahead = max(-most, min(most, ahead))
        gx, gy, gz = task.handle_at(task.position + ahead / task.lever)
        a, b = task.direction_at(task.position)
        behind = (tx - x) * a + (ty - y) * b  # kept, because the tool touches one side of the square
        return robot.towards((gx + behind * a, gy + behind * b, gz), 0.0)


def _body(middle: float) -> Link:
    """The fixed part on the floor: four boards around a drawer or behind a door.

    Args:
        middle: of the piece, in m to the side of the origin.
    """
    front, back = -BOARD, -BOARD - DEPTH
    side = DEPTH, BOARD, TOP
    shapes = [Cuboid(side, position=((front + back) / 2, middle + y, TOP / 2)) for y in (-WIDTH / 2, WIDTH / 2)]
    shapes.append(Cuboid((DEPTH, WIDTH, BOARD), position=((front + back) / 2, middle, TOP - BOARD / 2)))
    shapes.append(Cuboid((BOARD, WIDTH, TOP), position=(back + BOARD / 2, middle, TOP / 2)))
    return Link(name="piece", shapes=shapes, colour=PIECE_COLOUR)
