"""Push: the closed gripper slides a cube over the surface."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field as Setting

from ..core import Field, FloatArray, Layout
from ..core.seeding import Generator
from ..simulation.interface import Expert, RobotView
from ..simulation.world import World
from .cube import FAR, CubeSettings, CubeTask, aligned
from .fitting import fitting_threshold, surface
from .goals import NearGoal
from .placement import GOAL_COLOUR, place
from .push_expert import PushExpert

ROOM = 0.03
"""m between the side of the cube and the edge of the workspace, so that the gripper has room behind it."""


class Push(CubeTask):
    """What to do: slide the cube to the goal on the surface and leave it there. The gripper stays closed.

    What is randomised: cube and goal, uniformly in a square of .3 m in the middle of the workspace (`goals: workspace`:
    in all of it), as far as it leaves 3 cm between cube and edge for the gripper behind it; never so that the cube is
    there at the start.

    What counts as success: the centre of the cube lies within `threshold` of the goal. Only time ends an episode.

    Observation: `cube.FIELDS`, position, rotation (6), velocities of the cube and its place seen from the tool.
    Goals: achieved, the cube's position; desired, the goal's position; 3 numbers in m each.
    Reward: sparse -1 until there, then 0; dense minus the distance in m.
    """

    class Settings(CubeSettings):
        reward: Literal["sparse", "dense"] = Setting("sparse", description="-1 until there, or minus the distance in m")
        threshold: float = Setting(0.05, gt=0, le=0.5, description="distance at which the goal is reached, m")
        goals: Literal["box", "workspace"] = Setting(
            "box", description="a .3 m square amid the workspace, or all of it"
        )
        max_steps: int = Setting(50, ge=1, le=100_000, description="control steps per episode")

    uses_gripper = False
    settings: Settings
    achieved_goal = Layout((Field("object_position", 3, "m"),))
    desired_goal = Layout((Field("goal_position", 3, "m"),))

    def __init__(self, settings: Push.Settings) -> None:
        self.settings = settings
        self.goal = np.zeros(3, np.float32)

    @property
    def max_steps(self) -> int:
        return self.settings.max_steps

    def fit(self, robot: RobotView) -> None:
        self._robot = robot
        half = self.settings.object_size / 2
        self.ground = surface(robot.workspace, self.settings.goals, half, margin=half + ROOM)
        fitting_threshold(self.settings.threshold, self.ground)
        # dense: no cube that is not lost is further away than 10 m, and no goal than the workspace
        span = FAR + 2 * robot.workspace.diagonal
        self.goal_rule = NearGoal(self.settings.threshold, dense=self.settings.reward == "dense", span=span)

    def build(self, world: World) -> None:
        super().build(world)
        self._marker = world.marker(self.settings.threshold, GOAL_COLOUR)

    def reset(self, generator: Generator) -> None:
        self.cube.place(place(generator, self.ground, lambda _: True, "the cube").tolist(), aligned(self._robot))
        start = self.achieved()
        self.goal = place(generator, self.ground, lambda goal: not self.goal_rule.success(start, goal), "the goal")
        x, y, z = self.goal.tolist()
        self._marker.place((x, y, z))

    def achieved(self) -> FloatArray:
        return np.array(self.cube.position, np.float32)

    def expert(self) -> Expert:
        return PushExpert(self._robot, self)
