"""Push: the closed gripper slides a cube over the surface."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from pydantic import Field as Setting

from ..core import Field, FloatArray, Layout
from ..randomization.parameter import Parameter
from ..seeding import Generator
from ..simulation.interface import Expert, RobotView, Task
from ..simulation.world import World
from . import cube
from .fitting import fitting_threshold, surface
from .goals import NearGoal
from .placement import place
from .push_expert import PushExpert

AREA = 0.3
"""Edge in m of the square in the middle of the workspace in which cube and goal lie, as in panda-gym."""
MARGIN = 0.09
"""m that the workspace is larger than cube and goal on every side, so that the gripper has room behind the cube."""
GOAL_COLOUR = (0.16, 0.74, 0.32, 0.5)


class Push(Task):
    """What to do: slide the cube to the goal on the surface and leave it there. The gripper stays closed.

    What is randomised: cube and goal, uniformly in a square of .3 m in the middle of the workspace (`goals: workspace`:
    in all of it but 9 cm for the gripper behind the cube); never so that the cube is there at the start.

    What counts as success: the centre of the cube lies within `threshold` of the goal. Only time ends an episode.

    Observation: `cube.FIELDS`, position, rotation (6), velocities of the cube and its place seen from the tool.
    Goals: achieved, the cube's position; desired, the goal's position; 3 numbers in m each.
    Reward: sparse -1 until there, then 0; dense minus the distance in m.
    """

    class Settings(cube.CubeSettings):
        reward: Literal["sparse", "dense"] = Setting("sparse", description="-1 until there, or minus the distance in m")
        threshold: float = Setting(0.05, gt=0, le=0.5, description="distance at which the goal is reached, m")
        goals: Literal["box", "workspace"] = Setting(
            "box", description="a .3 m square amid the workspace, or all of it"
        )
        max_steps: int = Setting(50, ge=1, le=100_000, description="control steps per episode")

    uses_gripper = False
    observation = Layout(cube.FIELDS)
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
        box = robot.workspace
        edges = [high - low - 2 * MARGIN for low, high in zip(box.low, box.high, strict=True)]
        inner = box.middle((max(edges[0], 0.0), max(edges[1], 0.0), box.high[2] - box.low[2]))
        edge = None if self.settings.goals == "workspace" else AREA
        self.ground = surface(inner if edge is None else box, edge, self.settings.object_size / 2)
        fitting_threshold(self.settings.threshold, self.ground)
        # dense: no cube that is not lost is further away than 10 m, and no goal than the workspace
        span = cube.FAR + 2 * robot.workspace.diagonal
        self.goal_rule = NearGoal(self.settings.threshold, dense=self.settings.reward == "dense", span=span)

    def build(self, world: World) -> None:
        self._marker = world.marker(self.settings.threshold, GOAL_COLOUR)
        self.cube = cube.Cube(self.settings, world)

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        return {**super().parameters, **cube.parameters(self.settings)}

    def apply(self, world: World, name: str, value: float) -> None:
        if name == "object_mass":
            self.cube.set_mass(value)
        elif name == "object_friction":
            self.cube.body.set_friction(value)
        else:
            super().apply(world, name, value)

    def reset(self, generator: Generator) -> None:
        self.cube.place(place(generator, self.ground, lambda _: True, "the cube").tolist())
        start = self.achieved()
        self.goal = place(generator, self.ground, lambda goal: not self.goal_rule.success(start, goal), "the goal")
        x, y, z = self.goal.tolist()
        self._marker.place((x, y, z))

    def read(self) -> None:
        self.cube.read()

    def observe(self) -> list[float]:
        return self.cube.observe(self._robot.tool_position)

    def achieved(self) -> FloatArray:
        return np.array(self.cube.position, np.float32)

    def expert(self) -> Expert:
        return PushExpert(self._robot, self)

    def lost(self) -> bool:
        return self.cube.lost
