"""Pick and place: the gripper brings a cube to a point on the surface or in the air."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from pydantic import Field as Setting

from ..core import Field, FloatArray, Layout
from ..core.seeding import Generator
from ..randomization.parameter import Parameter
from ..simulation.body import Vector
from ..simulation.interface import Box, Expert, RobotView
from ..simulation.world import World
from .cube import CubeSettings, CubeTask, aligned
from .fitting import fitting_gripper, fitting_threshold, surface
from .goals import NearGoal, StagedPick
from .pick_expert import PickExpert
from .placement import GOAL_COLOUR, place

HEIGHT = 0.2
"""Highest goal above the surface in m, as in panda-gym."""
AIR = 0.7
"""Share of goals in the air."""


class PickPlace(CubeTask):
    """What to do: grasp the cube and bring it to the goal, held by friction alone.

    What is randomised: cube and goal, uniformly in a square of .3 m in the middle of the workspace (`goals: workspace`:
    in all of it); 30 % of the goals lie on the surface, 70 % in the air up to .2 m; never so that the cube is there at
    the start. A share `start_grasped` of the episodes begins with the cube in the gripper; as a parameter of domain
    randomization it does so in training alone, which is how Andrychowicz et al. 2017 begin half of their episodes.

    What counts as success: the centre of the cube lies within `threshold` of the goal. Only time ends an episode.

    Observation: `cube.FIELDS`, position, rotation (6), velocities of the cube and its place seen from the tool.
    Goals: achieved, the cube's position, with the dense reward also the tool's and the share of pads in contact;
    desired, the goal's position in m.
    Reward: sparse -1 until there, then 0; dense in [-1, 0], see `goals.StagedPick`.
    """

    class Settings(CubeSettings):
        reward: Literal["sparse", "dense"] = Setting("sparse", description="-1 until there, or staged in [-1, 0]")
        threshold: float = Setting(0.05, gt=0, le=0.5, description="distance at which the goal is reached, m")
        goals: Literal["box", "workspace"] = Setting(
            "box", description="a .3 m square amid the workspace, or all of it"
        )
        start_grasped: float = Setting(0.0, ge=0, le=1, description="share of episodes with the cube in the gripper")
        max_steps: int = Setting(50, ge=1, le=100_000, description="control steps per episode")

    uses_gripper = True
    settings: Settings
    achieved_goal = Layout((Field("object_position", 3, "m"),))
    desired_goal = Layout((Field("goal_position", 3, "m"),))

    def __init__(self, settings: PickPlace.Settings) -> None:
        self.settings = settings
        self._start_grasped = settings.start_grasped
        self.goal = np.zeros(3, np.float32)
        if settings.reward == "dense":
            self.achieved_goal = Layout(
                (Field("object_position", 3, "m"), Field("tool_position", 3, "m"), Field("pads_touching", 1))
            )

    @property
    def max_steps(self) -> int:
        return self.settings.max_steps

    def fit(self, robot: RobotView) -> None:
        settings, self._robot = self.settings, robot
        self.gripper = fitting_gripper(robot, type(self).__name__, settings.object_size)
        rest, highest = settings.object_size / 2, robot.workspace.high[2]
        self.ground = surface(robot.workspace, settings.goals, rest)
        top = highest if settings.goals == "workspace" else min(rest + HEIGHT, highest)
        (x, y, low), (u, v, _) = self.ground.low, self.ground.high
        self.air = Box((x, y, low), (u, v, top))
        fitting_threshold(settings.threshold, self.ground)
        if settings.reward == "dense":
            self.goal_rule = StagedPick(settings.threshold, rest=rest)
        else:
            self.goal_rule = NearGoal(settings.threshold, dense=False, span=1.0)

    def build(self, world: World) -> None:
        super().build(world)
        self._marker = world.marker(self.settings.threshold, GOAL_COLOUR)

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        odds = Parameter("1", self.settings.start_grasped, 0.0, 1.0, "odds that the cube starts in the gripper")
        return {**super().parameters, "start_grasped": odds}

    def apply(self, world: World, name: str, value: float) -> None:
        if name == "start_grasped":
            self._start_grasped = value
        else:
            super().apply(world, name, value)

    def reset(self, generator: Generator) -> None:
        self.cube.place(place(generator, self.ground, lambda _: True, "the cube").tolist(), aligned(self._robot))
        if generator.uniform() < self._start_grasped:
            self.cube.put_in_gripper(self._robot, self.cube.position)
        start = self.achieved()
        box = self.air if generator.uniform() < AIR else self.ground
        self.goal = place(generator, box, lambda goal: not self.goal_rule.success(start, goal), "the goal")
        x, y, z = self.goal.tolist()
        self._marker.place((x, y, z))

    def achieved(self) -> FloatArray:
        place: Vector = self.cube.position
        if self.settings.reward == "sparse":
            return np.array(place, np.float32)
        pads = self._robot.pads_touching(self.cube.body) / 2
        return np.array((*place, *self._robot.tool_position, pads), np.float32)

    def expert(self) -> Expert:
        return PickExpert(self._robot, self)
