"""Reach: the tool goes to a point."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field as Setting

from ..core import Field, FloatArray, Layout
from ..core import Settings as BaseSettings
from ..core.seeding import Generator
from ..simulation.interface import Box, Expert, RobotView, Task
from ..simulation.world import World
from .fitting import fitting_threshold
from .goals import NearGoal
from .placement import GOAL_COLOUR, place

GOAL_BOX = (0.3, 0.3, 0.3)
"""Edges in m of the box that goals are drawn from, as in panda-gym, so that figures compare."""


class ReachExpert(Expert):
    """Straight to the goal."""

    def __init__(self, robot: RobotView, task: Reach) -> None:
        self._robot = robot
        self._task = task

    def reset(self) -> None:
        pass

    def act(self) -> FloatArray:
        x, y, z = self._task.goal.tolist()
        return self._robot.towards((x, y, z), 0.0)


class Reach(Task):
    """What to do: bring the tool centre point to the goal and keep it there. The gripper stays closed.

    What is randomised: the goal, uniformly in a box of .3 m edges in the middle of the robot's workspace, or in all of
    the workspace; never so that it is reached at the start. The robot starts at its home pose but for the reset noise.

    What counts as success: the tool lies within `threshold` of the goal. The episode ends only when time is up.

    Observation: none of its own. Goals: achieved, the tool position; desired, the goal position; 3 numbers in m each.
    Reward: sparse -1 until there, then 0; dense minus the distance in m.
    """

    class Settings(BaseSettings):
        reward: Literal["sparse", "dense"] = Setting("sparse", description="-1 until there, or minus the distance in m")
        threshold: float = Setting(0.05, gt=0, le=0.5, description="distance at which the goal is reached, m")
        goals: Literal["box", "workspace"] = Setting("box", description="a .3 m box amid the workspace, or all of it")
        max_steps: int = Setting(50, ge=1, le=100_000, description="control steps per episode")

    uses_gripper = False
    observation = Layout()
    achieved_goal = Layout((Field("tool_position", 3, "m"),))
    desired_goal = Layout((Field("goal_position", 3, "m"),))

    def __init__(self, settings: Reach.Settings) -> None:
        self.settings = settings
        self.goal = np.zeros(3, np.float32)

    @property
    def max_steps(self) -> int:
        return self.settings.max_steps

    def fit(self, robot: RobotView) -> None:
        self._robot = robot
        self.box: Box = robot.workspace if self.settings.goals == "workspace" else robot.workspace.middle(GOAL_BOX)
        fitting_threshold(self.settings.threshold, self.box)
        # from the far end of the robot's reach to a goal; twice the workspace is more than any arm can stray
        span = 2 * robot.workspace.diagonal
        self.goal_rule = NearGoal(self.settings.threshold, dense=self.settings.reward == "dense", span=span)

    def build(self, world: World) -> None:
        self._marker = world.marker(self.settings.threshold, GOAL_COLOUR)

    def reset(self, generator: Generator) -> None:
        start = self.achieved()
        self.goal = place(generator, self.box, lambda goal: not self.goal_rule.success(start, goal), "the goal")
        x, y, z = self.goal.tolist()
        self._marker.place((x, y, z))

    def observe(self) -> list[float]:
        return []

    def achieved(self) -> FloatArray:
        return np.array(self._robot.tool_position, np.float32)

    def expert(self) -> Expert:
        return ReachExpert(self._robot, self)
