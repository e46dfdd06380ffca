"""Pick and place: the gripper brings a cube to a point on the floor or in the air."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field as Setting

from ..core import Array, Expert, Field, FloatArray, Generator, Layout
from ..core.parameters import Probability
from ..simulation.interface import Box, Cup, RobotView
from .cube import Carrier, CarryTask, CubeSettings, check_gripper, ground
from .point_goal import PointGoal, PointGoalSettings, PointGoalTask, sample_position
from .settings import drawn_stage, start

AIR_HEIGHT = 0.2
"""Highest goal above a resting cube in m, as in panda-gym."""
AIR_PROBABILITY = 0.7
"""Probability of a goal in the air."""


class StagedPick(PointGoal):
    """Reward in [-1, 0] for reaching, grasping, lifting and transporting an object: the mean of four stages, minus 1.

    It depends only on the state, so that an arm loses by leaving what it gains by approaching. `achieved` (..., 7) is
    the position of the object (3) and of the tool (3) in m, and the fraction of pads that grip; `desired` (..., 3).

    * reach: 1 - tanh(5 d), d from tool to object in m
    * grasp: fraction of pads whose inner faces touch the object
    * lift: fraction of the goal's height above the floor; 1 for a goal on the floor
    * transport: 1 - tanh(5 d), d from object to goal
    The reward is 0 if the goal is reached.

    Args:
        rest: height in m of the centre of an object on the floor.
    """

    place = slice(3)

    def __init__(self, threshold: float, *, rest: float) -> None:
        super().__init__(threshold, dense=True, span=1.0)
        self.rest = rest

    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        cube, tool, pads = achieved[..., :3], achieved[..., 3:6], achieved[..., 6]
        to_cube, to_goal = tool - cube, cube - desired
        reach = 1 - np.tanh(5 * np.sqrt(np.vecdot(to_cube, to_cube)))
        transport = 1 - np.tanh(5 * np.sqrt(np.vecdot(to_goal, to_goal)))
        height = desired[..., 2] - self.rest
        raised = np.clip((cube[..., 2] - self.rest) / np.maximum(height, 1e-3), 0, 1)
        lift = np.where(height < self.threshold, 1.0, raised)
        staged = (reach + pads + lift + transport) / 4 - 1
        return np.where(self.success(achieved, desired), 0.0, np.clip(staged, -1, 0)).astype(np.float32)


class PickPlace(PointGoalTask, CarryTask):
    """What to do: grasp the cube and bring it to the goal, held by friction alone.

    What is randomised: cube and goal, uniformly in a square of .3 m in the middle of the workspace (`goals: workspace`:
    in all of it); 30 % of the goals lie on the floor, 70 % in the air up to .2 m; the cube is never at the goal at the
    start. With probability `start_grasped` an episode begins with the cube in the gripper, as do half of the training
    episodes of Andrychowicz et al. 2017. Specs sample it, so tests never do. The other episodes begin with
    probability `start_near` with the open gripper around the cube or at most 8 cm above it.

    Observation: object_position (3, m), object_rotation (6, two columns of its matrix), object_velocity (3, m/s),
    object_angular_velocity (3, rad/s), object_from_tool (3, m).
    Action: the robot's, with the gripper.
    Goals: achieved, the cube's position (3, m), with the dense reward also the tool's (3, m) and the fraction of pads
    whose inner faces touch it; desired, the goal position (3, m).
    Reward: sparse -1 until the goal is reached, then 0; dense in [-1, 0], see `StagedPick`.
    What counts as success: the centre of the cube lies within `threshold` of the goal.
    Termination: never; the episode is truncated after `max_steps`.
    """

    class Settings(PointGoalSettings, CubeSettings):
        reward: Literal["sparse", "dense"] = Setting("sparse", description="-1 until success, or in [-1, 0] by stages")
        start_near: Probability = start("the gripper near the cube")
        start_grasped: Probability = start("the cube in the gripper")

    settings: Settings
    drawn: Settings
    protective_stop = False  # a learning policy presses on cube and floor; `force_penalty` teaches it not to
    achieved_goal = Layout((Field("object_position", 3, "m", kind="point"),))

    def __init__(self, settings: PickPlace.Settings) -> None:
        super().__init__(settings)
        if settings.reward == "dense":
            self.achieved_goal += Layout(
                (Field("tool_position", 3, "m", kind="point"), Field("pads_gripping", 1, kind="scalar"))
            )

    def fit(self, robot: RobotView) -> None:
        settings, self._robot = self.settings, robot
        self.gripper = check_gripper(robot, type(self).__name__, settings.object_size)
        rest, highest = settings.object_size / 2, robot.workspace.high[2]
        if isinstance(self.gripper, Cup):  # it is above the cube
            highest -= rest
        self.ground = ground(robot.workspace, settings.goals, rest)
        top = highest if settings.goals == "workspace" else min(rest + AIR_HEIGHT, highest)
        self.air = Box(self.ground.low, (*self.ground.high[:2], top))
        self._fit_goal(self.ground, span=1.0)
        if settings.reward == "dense":
            self.goal_rule = StagedPick(settings.threshold, rest=rest)

    def reset(self, generator: Generator) -> None:
        x, y, z = sample_position(generator, self.ground, "the cube").tolist()
        self.stage = drawn_stage(self.drawn, generator.uniform(), "grasped", "near")
        self._begin(self.cube, (x, y, z), self.stage, generator)
        self._sample_goal(generator, self.air if generator.uniform() < AIR_PROBABILITY else self.ground)

    def achieved(self) -> FloatArray:
        position = self.cube.position
        if self.settings.reward == "sparse":
            return np.array(position, np.float32)
        pads = self._robot.pads_gripping(self.cube.body) / 2
        return np.array((*position, *self._robot.tool_position, pads), np.float32)

    def expert(self) -> Expert:
        return PickExpert(self._robot, self)


class PickExpert(Expert):
    """Carries the cube to the goal and holds it there."""

    def __init__(self, robot: RobotView, task: PickPlace) -> None:
        self._task = task
        self._carrier = Carrier(robot, task.gripper)

    def reset(self) -> None:
        self._carrier.begin(self._task.cube)

    def act(self) -> FloatArray:
        x, y, z = self._task.goal.tolist()
        return self._carrier.act((x, y, z))
