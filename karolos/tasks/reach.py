"""Reach: the tool goes to a point."""

from __future__ import annotations

import numpy as np

from ..core import Expert, Field, FloatArray, Generator, Layout
from ..simulation.interface import RobotView
from .point_goal import PointGoalSettings, PointGoalTask

GOAL_BOX = (0.3, 0.3, 0.3)
"""Edges in m of the box of goals, as in panda-gym, so that results are comparable."""


class Reach(PointGoalTask):
    """What to do: bring the tool centre point to the goal and keep it there. The gripper stays closed.

    What is randomised: the goal, uniformly in a box of .3 m edges in the middle of the robot's workspace
    (`goals: workspace`: in all of it), never reached at the start. The robot starts at its home pose with reset noise.

    Observation: only the robot's.
    Action: the robot's, without the gripper.
    Goals: achieved, the tool position (3, m); desired, the goal position (3, m).
    Reward: sparse -1 until the goal is reached, then 0; dense minus the distance in m.
    What counts as success: the tool lies within `threshold` of the goal.
    Termination: never; the episode is truncated after `max_steps`.
    """

    Settings = PointGoalSettings
    uses_gripper = False
    protective_stop = False  # there is no obstacle
    achieved_goal = Layout((Field("tool_position", 3, "m", kind="point"),))

    def fit(self, robot: RobotView) -> None:
        self._robot = robot
        self.box = robot.workspace if self.settings.goals == "workspace" else robot.workspace.middle(GOAL_BOX)
        # twice the workspace: an arm cannot be further from a goal
        self._fit_goal(self.box, span=2 * robot.workspace.diagonal)

    def reset(self, generator: Generator) -> None:
        self._sample_goal(generator, self.box)

    def achieved(self) -> FloatArray:
        return np.array(self._robot.tool_position, np.float32)

    def expert(self) -> Expert:
        return ReachExpert(self._robot, self)


class ReachExpert(Expert):
    """Moves straight to the goal."""

    def __init__(self, robot: RobotView, task: Reach) -> None:
        self._robot = robot
        self._task = task

    def act(self) -> FloatArray:
        x, y, z = self._task.goal.tolist()
        return self._robot.towards((x, y, z), 0.0)
