"""A task with a part of somebody: an L from an STL is picked."""

from pathlib import Path

import numpy as np

from karolos.core import Expert, Field, FloatArray, Layout
from karolos.core.seeding import Generator
from karolos.environments.robot_task import RobotTask
from karolos.registry import load
from karolos.simulation.geometry import Vector, matrix_of
from karolos.simulation.interface import RobotView, Task, World
from karolos.simulation.shapes import Mesh, volume_of
from karolos.tasks.cube import aligned, braking, drift
from karolos.tasks.point_goal import PointGoal, PointGoalSettings


class PickPart(Task):
    """The L goes up to a point above where it lies."""

    Settings = PointGoalSettings
    uses_gripper = True
    achieved_goal = Layout((Field("part_position", 3, "m"),))
    desired_goal = Layout((Field("goal_position", 3, "m"),))
    part: Path

    def fit(self, robot: RobotView) -> None:
        self.robot, self.goal_rule = robot, PointGoal(0.02, dense=False, span=1.0)

    def build(self, world: World) -> None:
        shape = Mesh(self.part, 0.001, collision="decomposed")
        self.body = world.body([shape], 1200 * volume_of([shape]), (0.9, 0.5, 0.1, 1.0))

    def reset(self, generator: Generator) -> None:
        x, y, _ = self.robot.workspace.centre
        place = x + generator.uniform(-0.05, 0.05), y + generator.uniform(-0.05, 0.05), 0.0
        self.body.place(place, aligned(self.robot))
        self.goal = np.add(place, (0.0, 0.0, 0.12)).astype(np.float32)

    def achieved(self) -> FloatArray:
        return np.array(self.body.pose()[0], np.float32)

    def expert(self) -> Expert:
        return Picker(self)


class Picker(Expert):
    """Over the longer leg, down, closes, up."""

    def __init__(self, task: PickPart) -> None:
        self.task, self.down, self.closing = task, False, 0

    def reset(self) -> None:
        self.down, self.closing = False, 0

    def act(self) -> FloatArray:
        robot, (position, turn) = self.task.robot, self.task.body.pose()
        x, y, z = (position + matrix_of(turn) @ (0.045, 0.01, 0.014)).tolist()
        grip: Vector = (x, y, max(z, robot.workspace.low[2]))
        tx, ty, tz = robot.tool_position
        self.down |= np.hypot(tx - x, ty - y) < 0.01 and drift(robot) < 0.005
        if not self.down:
            return robot.towards(braking(robot, (x, y, 0.1)), 0.6)
        if self.closing == 0 and tz > grip[2] + 0.003:
            return robot.towards(braking(robot, grip), 0.6)
        self.closing += 1
        if self.closing < 8:
            return robot.towards(braking(robot, grip), 0.0)
        dx, dy, dz = (self.task.goal - position).tolist()
        return robot.towards(braking(robot, (tx + dx, ty + dy, tz + dz)), 0.0)


def with_part(task: type[Task], part: Path, robot: str, engine: str) -> RobotTask:
    """A robot with the task and its part."""
    arm, made = load("robots", robot), type(task.__name__, (task,), {"part": part})
    settings = RobotTask.Settings.model_validate({"engine": engine})
    return RobotTask(settings, robot=arm(arm.Settings()), task=made(made.Settings(max_steps=80)))
