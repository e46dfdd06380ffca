"""Two tasks with parts of somebody: an L from an STL is picked, a drawer from a URDF is opened."""

from __future__ import annotations

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

DRAWER = """
<robot name="drawer"><link name="floor"/><joint name="slide" type="prismatic"><parent link="floor"/><child link="tray"/>
  <axis xyz="-1 0 0"/><limit lower="0" upper=".15"/><dynamics friction="3" damping="5"/></joint>
  <link name="tray"><inertial><mass value=".5"/>
    <inertia ixx=".002" iyy=".002" izz=".002" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz=".1 0 .015"/><geometry><box size=".2 .1 .02"/></geometry></collision>
    <collision><origin xyz="0 0 .05"/><geometry><box size=".02 .1 .09"/></geometry></collision></link></robot>
"""
"""A tray on the floor with a plate at its front, behind which a closed gripper pulls."""


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


class OpenDrawer(Task):
    """The drawer is to stand open by 10 cm."""

    Settings = PointGoalSettings
    uses_gripper = False
    achieved_goal = Layout((Field("drawer_position", 1, "m"),))
    desired_goal = Layout((Field("goal_position", 1, "m"),))
    part: Path

    def fit(self, robot: RobotView) -> None:
        self.robot, self.goal_rule = robot, PointGoal(0.01, dense=False, span=1.0)
        self.goal = np.array([0.1], np.float32)

    def build(self, world: World) -> None:
        self.body = world.load(self.part)

    def reset(self, generator: Generator) -> None:
        x, y, _ = self.robot.workspace.centre
        self.front = x + generator.uniform(0.0, 0.03), y + generator.uniform(-0.1, 0.1)
        self.body.place((*self.front, 0.0))
        self.body.place_joint("slide", generator.uniform(0.0, 0.02))

    def achieved(self) -> FloatArray:
        return np.array([self.body.joint("slide")[0]], np.float32)

    def expert(self) -> Expert:
        return Puller(self)


class Puller(Expert):
    """Down behind the plate, then back until the drawer stands where it should."""

    def __init__(self, task: OpenDrawer) -> None:
        self.task = task

    def act(self) -> FloatArray:
        robot, position = self.task.robot, self.task.body.joint("slide")[0]
        (x, y), (tx, ty, tz) = self.task.front, robot.tool_position
        behind, low = x - position + 0.06, 0.065
        if tz > low + 0.01 and np.hypot(tx - behind, ty - y) > 0.01:
            return robot.towards(braking(robot, (behind, y, 0.16)), 0.0)
        if tz > low + 0.01:
            return robot.towards(braking(robot, (behind, y, low)), 0.0)
        return robot.towards(braking(robot, (tx - min(self.task.goal[0] - position, 0.02), y, low)), 0.0)


def with_part(task: type[Task], part: Path, robot: str, engine: str) -> RobotTask:
    """A robot with one of these tasks and its part."""
    arm, made = load("robots", robot), type(task.__name__, (task,), {"part": part})
    settings = RobotTask.Settings.model_validate({"engine": engine})
    return RobotTask(settings, robot=arm(arm.Settings()), task=made(made.Settings(max_steps=80)))
