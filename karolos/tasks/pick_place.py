"""Pick and place: the gripper brings a cube to a point on the floor or in the air."""

from __future__ import annotations

from math import hypot
from typing import Literal

import numpy as np
from pydantic import Field as Setting

from ..core import Array, BoolArray, Expert, Field, FloatArray, Layout
from ..core.seeding import Generator
from ..randomization.randomization import Probability
from ..simulation.geometry import Vector
from ..simulation.interface import Box, RobotView
from .cube import CubeSettings, CubeTask, aligned, braking, check_gripper, drift, ground
from .point_goal import PointGoal, PointGoalSettings, PointGoalTask, sample_position

AIR_HEIGHT = 0.2
"""Highest goal above a resting cube in m, as in panda-gym."""
AIR_PROBABILITY = 0.7
"""Probability of a goal in the air."""


class StagedPick(PointGoal):
    """Reward in [-1, 0] for reaching, grasping, lifting and transporting an object: the mean of four stages, minus 1.

    A function of the state alone, so that an arm loses by leaving what it gains by approaching. `achieved` (..., 7) is
    the position of the object (3) and of the tool (3) in m, and the fraction of pads that grip; `desired` (..., 3).

    * reach: 1 - tanh(5 d), d from tool to object in m
    * grasp: fraction of pads whose inner faces touch the object
    * lift: fraction of the goal's height above the floor; 1 for a goal on the floor
    * transport: 1 - tanh(5 d), d from object to goal
    The reward is 0 where the goal is reached.

    Args:
        rest: height in m of the centre of an object on the floor.
    """

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
        reward: FloatArray = np.where(self.success(achieved, desired), 0.0, np.clip(staged, -1, 0)).astype(np.float32)
        return reward

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        return super().success(achieved[..., :3], desired)

    def distance(self, achieved: Array, desired: Array) -> FloatArray:
        return super().distance(achieved[..., :3], desired)


class PickPlace(PointGoalTask, CubeTask):
    """What to do: grasp the cube and bring it to the goal, held by friction alone.

    What is randomised: cube and goal, uniformly in a square of .3 m in the middle of the workspace (`goals: workspace`:
    in all of it); 30 % of the goals lie on the floor, 70 % in the air up to .2 m; the cube is never at the goal at the
    start. With probability `start_grasped` an episode begins with the cube in the gripper; as a parameter of domain
    randomization it does so in training alone, as half of the episodes in Andrychowicz et al. 2017. Of the others, with
    probability `start_near` an episode begins with the open gripper around the cube or at most 8 cm above it.

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
        reward: Literal["sparse", "dense"] = Setting("sparse", description="-1 until there, or staged in [-1, 0]")
        start_near: Probability = Setting(
            0.0, description="probability that an episode starts with the gripper near the cube"
        )
        start_grasped: Probability = Setting(
            0.0, description="probability that an episode starts with the cube in the gripper"
        )

    settings: Settings
    drawn: Settings
    uses_gripper = True
    protective_stop = False  # reference runs were made without
    achieved_goal = Layout((Field("object_position", 3, "m"),))

    def __init__(self, settings: PickPlace.Settings) -> None:
        super().__init__(settings)
        if settings.reward == "dense":
            self.achieved_goal += Layout((Field("tool_position", 3, "m"), Field("pads_gripping", 1)))

    def fit(self, robot: RobotView) -> None:
        settings, self._robot = self.settings, robot
        self.gripper = check_gripper(robot, type(self).__name__, settings.object_size)
        rest, highest = settings.object_size / 2, robot.workspace.high[2]
        self.ground = ground(robot.workspace, settings.goals, rest)
        top = highest if settings.goals == "workspace" else min(rest + AIR_HEIGHT, highest)
        self.air = Box(self.ground.low, (*self.ground.high[:2], top))
        self._fit_goal(self.ground, span=1.0)
        if settings.reward == "dense":
            self.goal_rule = StagedPick(settings.threshold, rest=rest)

    def reset(self, generator: Generator) -> None:
        robot, (x, y, z) = self._robot, sample_position(generator, self.ground, "the cube").tolist()
        grasped, start = self.drawn.start_grasped, generator.uniform()
        if start < grasped:
            self.cube.put_in_gripper(robot, self.gripper, (x, y, z))
        elif start < grasped + (1 - grasped) * self.drawn.start_near:
            self.cube.place_with_tool(robot, (x, y, z), (x, y, z + generator.uniform(GRIP_HEIGHT, HOVER_HEIGHT)), 1.0)
        else:
            self.cube.place((x, y, z), aligned(robot))
        self._sample_goal(generator, self.air if generator.uniform() < AIR_PROBABILITY else self.ground)

    def achieved(self) -> FloatArray:
        position = self.cube.position
        if self.settings.reward == "sparse":
            return np.array(position, np.float32)
        pads = self._robot.pads_gripping(self.cube.body) / 2
        return np.array((*position, *self._robot.tool_position, pads), np.float32)

    def expert(self) -> Expert:
        return PickExpert(self._robot, self)


HOVER_HEIGHT = 0.08
"""m above the cube at which the gripper arrives."""
ALIGNED_DISTANCE = 0.018
"""m off the cube's axis at which the gripper may go down; open, it has 1.5 cm to each side of a 4 cm cube."""
STILL_DRIFT = 0.015
"""Largest horizontal drift of the tool, in m per control step, when it goes down or closes."""
GRIP_HEIGHT = 0.006
"""m above the centre of the cube at which it is gripped, so that the pads do not rub on the floor: there the fingers
stick, and an arm that drags them along lags behind."""
CARRYING_CLEARANCE = 0.03
"""m above the floor at which the cube moves to a goal on the floor: a dragged cube twists out of the pads."""
SET_DOWN_GAP = 0.003
"""m above the floor at which the cube is held over a goal on the floor: an arm that aims at the floor presses on it."""
CLOSING_STEPS = 3
"""Control steps for which both pads must touch before the cube is lifted: until then they push it to the middle."""
GRASP_PATIENCE = 30
"""Control steps after which a gripper that has closed on nothing opens again."""


class PickExpert(Expert):
    """Goes over the cube, down, closes, lifts, moves to the goal. Restarts when it loses the cube."""

    def __init__(self, robot: RobotView, task: PickPlace) -> None:
        self._robot = robot
        self._task = task
        # wide enough for a cube on its diagonal
        self._open = min(1.0, (1.5 * task.settings.object_size + 0.01) / task.gripper.width)
        self._closing = 0
        """Control steps since the gripper began to close; 0 while it is open."""
        self._held = 0
        """Control steps for which the cube has been between the pads."""

    def reset(self) -> None:
        self._held = CLOSING_STEPS if self._enclosed() else 0
        self._closing = self._held

    def _enclosed(self) -> bool:
        """Whether the cube is between the pads; on its diagonal it is 1.42 times as wide as along its edges."""
        robot, cube, size = self._robot, self._task.cube.position, self._task.settings.object_size
        near = sum((a - b) ** 2 for a, b in zip(robot.tool_position, cube, strict=True)) < size**2
        return near and 0.8 * size < robot.opening * self._task.gripper.width < 1.45 * size

    def _holding(self) -> bool:
        """Whether the cube is between the pads, and both touched it before it was lifted."""
        return self._enclosed() and (
            self._held >= CLOSING_STEPS or self._robot.pads_touching(self._task.cube.body) == 2
        )

    def act(self) -> FloatArray:
        robot, (x, y, z), (tx, ty, tz) = self._robot, self._task.cube.position, self._robot.tool_position
        grip: Vector = (x, y, max(z + GRIP_HEIGHT, robot.workspace.low[2]))
        if self._closing:
            self._closing += 1
            lifted = self._held > CLOSING_STEPS
            self._held = self._held + 1 if self._holding() else 0
            if self._held > CLOSING_STEPS:
                return robot.towards(self._transport(), 0.0)
            if not lifted and self._closing < GRASP_PATIENCE:
                return robot.towards((tx, ty, tz) if self._held else grip, 0.0)
            self._closing = 0
        error, above = hypot(tx - x, ty - y), z + HOVER_HEIGHT
        high = tz > z + HOVER_HEIGHT / 2
        if error > ALIGNED_DISTANCE or (high and drift(robot) > STILL_DRIFT):
            target: Vector = (x, y, above) if high else (tx, ty, above)
            return robot.towards(braking(robot, target), self._open)
        if tz > grip[2] + 0.006 or drift(robot) > STILL_DRIFT:
            return robot.towards(braking(robot, grip), self._open)
        self._closing = 1
        return robot.towards(grip, 0.0)

    def _transport(self) -> Vector:
        """Position of the tool at which the cube, as it lies in the gripper, is at the goal."""
        tool, cube, goal = self._robot.tool_position, self._task.cube, self._task.goal.tolist()
        x, y, z = (t + g - c for t, g, c in zip(tool, goal, cube.position, strict=True))
        if hypot(x - tool[0], y - tool[1]) > CARRYING_CLEARANCE:
            if cube.lowest < CARRYING_CLEARANCE / 3:
                return tool[0], tool[1], tool[2] + CARRYING_CLEARANCE
            z = max(z, tool[2] + CARRYING_CLEARANCE - cube.lowest)
        return x, y, max(z, self._robot.workspace.low[2], tool[2] + SET_DOWN_GAP - cube.lowest)
