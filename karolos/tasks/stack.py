"""Stack: the gripper puts one cube on another, or two on one, and releases them."""

from __future__ import annotations

from itertools import pairwise
from math import tanh
from typing import Literal

import numpy as np
from pydantic import Field as Setting

from ..core import Expert, Field, FloatArray, Generator, Layout, Measure
from ..core.parameters import Probability
from ..core.settings import LATER
from ..errors import UsageError
from ..simulation.geometry import Vector
from ..simulation.interface import RobotView
from .cube import CUBE_COLOUR, HOVER_HEIGHT, Carrier, CarryTask, CubeSettings, aligned, check_gripper, fields, ground
from .point_goal import Places, sample_apart, sample_held
from .settings import drawn_stage, start

GAP = {2: 0.06, 3: 0.1}
"""Number of cubes -> smallest distance in m between their sides at the start: room for the fingers, or for the hand
with a stack of two."""
ABOVE = 0.05
"""Largest height in m above its place of a cube that starts there in the gripper."""
NEAR_SCALE = 0.02
"""Scale in m of additional observations tanh(error / scale), in which a network sees millimetres."""


class Stack(CarryTask):
    """What to do: put the second cube on the first, with `height: 3` the third on the second, and release it.

    What is randomised: the cubes, uniformly in a square of .3 m in the middle of the workspace, their sides at least
    6 cm apart, with `height: 3` 10 cm. Stages that training may sample and tests never do: with `height: 3` and
    `start_stacked` the second cube already lies on the first. The next cube, each among the episodes without an earlier
    stage: `start_above` (in the gripper up to 5 cm above its place), `start_grasped` (in the gripper where it lies),
    `start_near` (with the open gripper around or above it). With `goal_held` some training episodes have another goal:
    to hold the second of two cubes up to 15 cm above its place in the pile, anywhere in the square.

    Observation: of each cube, from the lowest: cube_1_position (3, m), cube_1_rotation (6, two columns of its matrix),
    cube_1_velocity (3, m/s), cube_1_angular_velocity (3, rad/s), cube_1_from_tool (3, m); then cube_2_from_cube_1
    (3, m) and cube_2_error (3, tanh of the way from its place on cube_1 over 2 cm), with `height: 3` also of cube_3.
    Action: the robot's, with the gripper.
    Goals: achieved, cube_2_from_cube_1 (3, m), with `height: 3` also cube_3_from_cube_2, and whether the robot touches
    no cube and all are at rest (1); desired, an edge above one another and 1.
    Reward: sparse -1 until the cubes are stacked, then 0; with three cubes -.5 after the first two are stacked; less if
    a force exceeds that of `force_penalty`.
    What counts as success: each cube is within `threshold` of its place on the cube below, and all are released and at
    rest. A cube that lies next to the other one or is held on it does not count.
    Termination: never; the episode is truncated after `max_steps`.
    """

    class Settings(CubeSettings):
        height: Literal[2, 3] = Setting(2, description="number of cubes")
        threshold: float = Setting(0.015, gt=0, le=0.1, description="distance of a cube from its place, m")
        start_stacked: Probability = start("the second of three cubes on the first")
        start_above: Probability = start("the next cube in the gripper above its place")
        start_grasped: Probability = start("the next cube in the gripper")
        start_near: Probability = start("the gripper near the next cube")
        goal_held: Probability = Setting(
            0.0,
            json_schema_extra=LATER,
            description="share of episodes whose goal is to hold the second of two cubes somewhere in the air",
        )
        max_steps: int = Setting(
            100, ge=1, le=100_000, description="control steps per episode; three cubes take twice as many"
        )

    settings: Settings
    drawn: Settings
    protective_stop = False  # a learning policy presses on the cubes; `force_penalty` teaches it not to
    colours = (CUBE_COLOUR, (0.16, 0.5, 0.8, 1.0), (0.85, 0.75, 0.2, 1.0))
    distance_measure = Measure("miss", "m", "smaller", "distance of the furthest cube from its place at the end")

    def __init__(self, settings: Stack.Settings) -> None:
        self.number = number = settings.height
        pairs = [f"cube_{k + 1}_from_cube_{k}" for k in range(1, number)]
        self.achieved_goal = self.desired_goal = Layout(
            (*(Field(name, 3, "m", kind="vector") for name in pairs), Field("let_go", 1, kind="scalar"))
        )
        observed = [field for k in range(1, number + 1) for field in fields(f"cube_{k}")]
        for k, name in enumerate(pairs, 2):
            observed += [Field(name, 3, "m", kind="vector"), Field(f"cube_{k}_error", 3, kind="vector")]
        self.observation = Layout(tuple(observed))
        super().__init__(settings)
        self.goal_rule = Places(settings.threshold)
        self.stacked = np.array((0.0, 0.0, settings.object_size) * (number - 1) + (1.0,), np.float32)
        """The goal of tests."""
        self.goal = self.stacked

    def fit(self, robot: RobotView) -> None:
        settings, self._robot = self.settings, robot
        self.gripper = check_gripper(robot, type(self).__name__, settings.object_size)
        self.ground = ground(robot.workspace, "box", settings.object_size / 2)
        if settings.threshold >= settings.object_size / 2:
            raise UsageError(
                f"a cube {settings.threshold:g} m off its place does not stand on the other one",
                setting="task.threshold",
                hint=f"set less than {settings.object_size / 2:g} m, half an edge",
            )
        if (top := settings.object_size * (settings.height + 0.5) + HOVER_HEIGHT) > robot.workspace.high[2]:
            raise UsageError(
                f"the tool has to rise to {top:.2f} m",
                setting="task.object_size",
                hint=f"its workspace is {robot.workspace.high[2]:g} m high; take smaller cubes",
            )

    def reset(self, generator: Generator) -> None:
        edge, robot = self.settings.object_size, self._robot
        places = sample_apart(generator, self.ground, self.number, GAP[self.number] + edge, "the cubes")
        standing = 1 + bool(self.number > 2 and drawn_stage(self.drawn, generator.uniform(), "stacked"))
        x, y, z = places[0]
        places[:standing] = [(x, y, z + k * edge) for k in range(standing)]
        for cube, place in zip(self.cubes, places, strict=True):
            cube.place(place, aligned(robot))
        stage = self.stage = drawn_stage(self.drawn, generator.uniform(), "above", "grasped", "near")
        cube = self.cubes[standing]
        if stage == "above":
            stage, places[standing] = "grasped", (x, y, z + standing * edge + ABOVE * generator.uniform())
        self._begin(cube, places[standing], stage, generator)
        self._free = stage != "grasped"
        self.goal = self.stacked
        if self.number == 2 and self.drawn.goal_held and generator.uniform() < self.drawn.goal_held:
            self.goal = sample_held(generator, self.ground, (x, y, z - edge))  # above its place in the pile

    def read(self) -> None:
        super().read()
        self._free = self.let_go()

    @property
    def offsets(self) -> list[Vector]:
        """The position of each cube relative to the cube below, in m, without the lowest one."""
        return [_difference(upper.position, lower.position) for lower, upper in pairwise(self.cubes)]

    def observe(self) -> list[float]:
        seen = [cube.observe(self._robot) for cube in self.cubes]
        values = [value for one in seen for value in one]
        for lower, upper in pairwise(seen):
            x, y, z = _difference(upper, lower)
            errors = x, y, z - self.settings.object_size
            values += [x, y, z, *(tanh(error / NEAR_SCALE) for error in errors)]
        return values

    def achieved(self) -> FloatArray:
        return np.array([*(value for offset in self.offsets for value in offset), self._free], np.float32)

    def expert(self) -> Expert:
        return StackExpert(self._robot, self)


def _difference(one: list[float] | Vector, other: list[float] | Vector) -> Vector:
    return one[0] - other[0], one[1] - other[1], one[2] - other[2]


PLACED = 0.005
"""Distance in m from its place, along each axis, at which a cube is released."""


class StackExpert(Expert):
    """Carries the lowest misplaced cube to its place, opens, rises, and continues with the next one."""

    def __init__(self, robot: RobotView, task: Stack) -> None:
        self._robot, self._task = robot, task
        self._carrier = Carrier(robot, task.gripper)

    def reset(self) -> None:
        self._leaving = False
        self._begin(self._next())

    def _begin(self, level: int) -> None:
        self._level = level
        self._carrier.begin(self._task.cubes[min(level, self._task.number - 1)])

    def _next(self) -> int:
        """Number of cubes on their places."""
        task = self._task
        for level, (x, y, z) in enumerate(task.offsets, 1):
            held = self._robot.pads_touching(task.cubes[level].body)
            near = PLACED if held else task.settings.threshold
            if max(abs(x), abs(y), abs(z - task.settings.object_size)) > near:
                return level
        return task.number

    def act(self) -> FloatArray:
        robot, task, level = self._robot, self._task, self._next()
        (x, y, z), edge = robot.tool_position, task.settings.object_size
        if level > self._level or level == task.number:
            self._leaving = True
        if level != self._level:
            self._begin(level)
        if self._leaving:
            touching = any(robot.pads_touching(cube.body) for cube in task.cubes)
            top = level * edge + HOVER_HEIGHT
            self._leaving = touching or z < top - HOVER_HEIGHT / 2
            return robot.towards((x, y, z if touching else top), self._carrier.open)
        bx, by, bz = task.cubes[level - 1].position
        return self._carrier.act((bx, by, bz + edge), level * edge)
