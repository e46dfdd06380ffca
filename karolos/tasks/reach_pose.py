"""Reach pose: the tool goes to a point and takes an orientation."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field as Setting

from ..core import Expert, FloatArray, Generator, Layout, Settings
from ..simulation.geometry import axes
from ..simulation.interface import RobotView, Stroke, Task, World
from .point_goal import GOAL_COLOUR, check_threshold, sample_position
from .pose_goal import PoseGoal, check_turning, pose_array, pose_fields, sample_orientation

GOAL_BOX = (0.16, 0.24, 0.24)
"""Edges in m of the box of goals. Every built-in arm can turn its tool in a box of this size."""
AXIS_COLOURS = (0.86, 0.24, 0.2, 1.0), (0.16, 0.6, 0.3, 1.0), (0.2, 0.4, 0.86, 1.0)
AXIS_LENGTH = 0.06
"""Length in m of the axes that pictures show at the goal."""


class ReachPoseSettings(Settings):
    """Settings of reach_pose."""

    reward: Literal["sparse", "dense"] = Setting(
        "sparse", description="-1 until success, or minus the distance in m and .1 m per rad"
    )
    threshold: float = Setting(0.01, gt=0, le=0.5, description="distance at which the position is reached, m")
    angle_threshold: float = Setting(
        0.0873, gt=0, le=3.15, description="angle at which the orientation is reached, rad; default: 5 degrees"
    )
    max_steps: int = Setting(50, ge=1, le=100_000, description="control steps per episode")


class ReachPose(Task):
    """What to do: bring the tool centre point to the goal, turn the tool as the goal says, and keep both.

    What is randomised: the goal. Its position is uniform in a box of .16 by .24 by .24 m in the middle of the robot's
    dexterous space. The tool is turned by up to .8 rad about the vertical and tilted by up to .3 rad from pointing
    down (built-in arms). The robot starts at its home pose with reset noise.

    Observation: only the robot's.
    Action: the robot's, without the gripper.
    Goals: achieved, position (3, m) and rotation (6, the first two columns of its matrix) of the tool; desired, the
    same of the goal.
    Reward: sparse -1 until the goal is reached, then 0; dense minus the distance in m, minus .1 m per rad of the angle.
    What counts as success: the tool lies within `threshold` of the goal, and is turned by less than `angle_threshold`
    from it.
    Termination: never; the episode is truncated after `max_steps`.
    """

    Settings = ReachPoseSettings
    uses_gripper = False
    control = "pose"
    achieved_goal = Layout(pose_fields("tool"))
    desired_goal = Layout(pose_fields("goal"))

    def fit(self, robot: RobotView) -> None:
        self._robot = robot
        self.box = check_turning(robot).middle(GOAL_BOX)
        settings = self.settings
        check_threshold(settings.threshold, self.box)
        dense, span = settings.reward == "dense", 2 * robot.workspace.diagonal
        self.goal_rule = PoseGoal(settings.threshold, settings.angle_threshold, dense=dense, span=span)

    def build(self, world: World) -> None:
        super().build(world)
        self._marker = world.marker(0.015, GOAL_COLOUR)

    def reset(self, generator: Generator) -> None:
        start = self.achieved()
        self.orientation = sample_orientation(generator, self._robot.orientations)

        def away(position: FloatArray) -> bool:
            return not self.goal_rule.success(start, pose_array(position.tolist(), self.orientation))

        x, y, z = self.position = sample_position(generator, self.box, "the goal", away).tolist()
        self.goal = pose_array(self.position, self.orientation)
        self._marker.place((x, y, z))

    def achieved(self) -> FloatArray:
        tool = self._robot.tool
        return np.array([*tool.position, *tool.x, *tool.y], np.float32)

    def strokes(self) -> list[Stroke]:
        """The axes of the tool at the goal; the last one shows the direction of approach."""
        x, y, z = self.position
        ends = [(AXIS_LENGTH * a, AXIS_LENGTH * b, AXIS_LENGTH * c) for a, b, c in axes(self.orientation)]
        ends[2] = -ends[2][0], -ends[2][1], -ends[2][2]
        lines = [((x, y, z), (x + a, y + b, z + c)) for a, b, c in ends]
        return [Stroke(line, colour) for line, colour in zip(lines, AXIS_COLOURS, strict=True)]

    def expert(self) -> Expert:
        return ReachPoseExpert(self._robot, self)


class ReachPoseExpert(Expert):
    """Moves straight to the goal and turns the tool on the way."""

    def __init__(self, robot: RobotView, task: ReachPose) -> None:
        self._robot = robot
        self._task = task

    def act(self) -> FloatArray:
        x, y, z = self._task.position
        return self._robot.towards((x, y, z), 0.0, self._task.orientation)
