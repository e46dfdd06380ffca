"""Bin: the gripper puts a cube into a bin and releases it. There is no scripted expert."""

from __future__ import annotations

import numpy as np
from pydantic import Field as Setting

from karolos.core import Field, FloatArray, Generator, Layout, Measure
from karolos.core.parameters import Probability
from karolos.errors import UsageError
from karolos.simulation.geometry import Vector
from karolos.simulation.interface import RobotView, World
from karolos.simulation.shapes import Cuboid
from karolos.tasks.cube import CarryTask, CubeSettings, aligned, check_gripper, fields, ground
from karolos.tasks.point_goal import Places, sample_apart, sample_held
from karolos.tasks.settings import drawn_stage, start

INSIDE, WALL, HEIGHT = 0.1, 0.005, 0.04
"""Inner edge of the bin, thickness of its walls and floor, and their height, in m."""
APART = 0.12
"""Least distance in m of the cube from the middle of the bin at the start."""
ABOVE = (0.05, 0.12)
"""Height in m above the floor of a cube that begins in the gripper above the bin."""
GREY = (0.45, 0.5, 0.55, 1.0)


def bin_shapes() -> list[Cuboid]:
    """A floor and four walls; the origin is in the middle of the floor's lower side."""
    side, outer = (INSIDE + WALL) / 2, INSIDE + 2 * WALL
    walls = [((WALL, outer, HEIGHT), (x, 0.0, HEIGHT / 2)) for x in (-side, side)]
    walls += [((outer, WALL, HEIGHT), (0.0, y, HEIGHT / 2)) for y in (-side, side)]
    return [
        Cuboid((outer, outer, WALL), position=(0.0, 0.0, WALL / 2)),
        *(Cuboid(size, position=place) for size, place in walls),
    ]


class Bin(CarryTask):
    """What to do: put the cube into the bin and let go.

    What is randomised: cube and bin, uniformly in a square of .3 m in the middle of the workspace, at least 12 cm
    apart. The cube begins in the gripper above the bin with probability `start_above`, of the other episodes in the
    gripper where it lies with `start_grasped`, of the others with the open gripper around or above it with
    `start_near`. With `goal_held` some goals are to hold the cube up to 15 cm above the floor, anywhere in the square.
    Training may draw these parameters, tests never do.

    Observation: of the cube, position (3, m), rotation (6), velocity (3, m/s), angular_velocity (3, rad/s), from_tool
    (3, m); then bin_position (3, m) and cube_from_bin (3, m).
    Action: the robot's, with the gripper.
    Goals: achieved, cube_from_bin (3, m) and whether it is let go and at rest (1); desired, its place on the
    bin's floor and 1.
    Reward: sparse -1 until the goal is reached, then 0; less where a force exceeds that of `force_penalty`.
    What counts as success: the cube lies in the bin, at rest, and the robot does not touch it.
    Termination: never; the episode is truncated after `max_steps`.
    """

    class Settings(CubeSettings):
        threshold: float = Setting(
            0.045, gt=0, le=0.05, description="distance from the middle at which it is inside, m"
        )
        start_above: Probability = start("the cube in the gripper above the bin")
        start_grasped: Probability = start("the cube in the gripper")
        start_near: Probability = start("the gripper near the cube")
        goal_held: Probability = Setting(0.0, description="share of goals that are to hold the cube in the air")
        max_steps: int = Setting(50, ge=1, le=100_000, description="control steps per episode")

    settings: Settings
    drawn: Settings
    protective_stop = False  # a policy that learns presses on the cube; `force_penalty` teaches it not to
    observation = Layout(
        (*fields("object"), Field("bin_position", 3, "m", kind="point"), Field("cube_from_bin", 3, "m", kind="vector"))
    )
    achieved_goal = desired_goal = Layout(
        (Field("cube_from_bin", 3, "m", kind="vector"), Field("let_go", 1, kind="scalar"))
    )
    distance_measure = Measure("miss", "m", "smaller", "distance of the cube from the middle of the bin at the end")

    def __init__(self, settings: Bin.Settings) -> None:
        super().__init__(settings)
        self.goal_rule = Places(settings.threshold)
        self.inside = np.array((0.0, 0.0, WALL + settings.object_size / 2, 1.0), np.float32)
        self.goal = self.inside

    def fit(self, robot: RobotView) -> None:
        size, self._robot = self.settings.object_size, robot
        self.gripper = check_gripper(robot, "Bin", size)
        self.ground = ground(robot.workspace, "box", size / 2)
        if size >= INSIDE / 2:
            what = f"a cube of {size:g} m does not fall into the bin from a gripper"
            raise UsageError(what, setting="task.object_size", hint=f"the bin is {INSIDE:g} m wide; take half or less")

    def build(self, world: World) -> None:
        super().build(world)
        self._bin = world.body(bin_shapes(), 0.0, GREY)

    def reset(self, generator: Generator) -> None:
        place, (x, y, _) = sample_apart(generator, self.ground, 2, APART, "cube and bin")
        self._bin.place((x, y, 0.0), aligned(self._robot))
        self.at = (x, y, 0.0)
        stage = self.stage = drawn_stage(self.drawn, generator.uniform(), "above", "grasped", "near")
        if stage == "above":
            stage, place = "grasped", (x, y, HEIGHT + generator.uniform(*ABOVE))
        self._begin(self.cube, place, stage, generator)
        self._free = stage != "grasped"
        self.goal = self.inside
        if generator.uniform() < self.drawn.goal_held:
            self.goal = sample_held(generator, self.ground, self.at)

    def read(self) -> None:
        super().read()
        self._free = self.let_go()

    def _offset(self, position: Vector | list[float]) -> list[float]:
        """Of the cube from the bin, in m."""
        return [own - other for own, other in zip(position, self.at, strict=False)]

    def observe(self) -> list[float]:
        seen = self.cube.observe(self._robot)
        return [*seen, *self.at, *self._offset(seen[:3])]

    def achieved(self) -> FloatArray:
        return np.array([*self._offset(self.cube.position), self._free], np.float32)
