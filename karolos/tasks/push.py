"""Push: the closed gripper slides a cube over the floor."""

from __future__ import annotations

from math import cos, hypot, pi, sin

import numpy as np

from ..core import Expert, Field, FloatArray, Generator, Layout
from ..core.parameters import Probability
from ..simulation.geometry import Vector
from ..simulation.interface import RobotView
from .cube import LOST_DISTANCE, CubeSettings, CubeTask, aligned, braking, drift, ground
from .point_goal import PointGoalSettings, PointGoalTask, sample_position
from .settings import drawn_stage, start

CUBE_MARGIN = 0.03
"""Distance in m between the side of the cube and the edge of the workspace: room for the gripper behind the cube."""
NEAR_DISTANCES = (0.055, 0.2)
"""Distance in m along the floor between the centres of cube and tool at a start near the cube."""
NEAR_HEIGHT = 0.1
"""Largest height in m above the floor of a start near the cube."""


class Push(PointGoalTask, CubeTask):
    """What to do: slide the cube to the goal on the floor and leave it there. The gripper stays closed.

    What is randomised: cube and goal, uniformly in a square of .3 m in the middle of the workspace (`goals: workspace`:
    in all of it), at least 3 cm from its edges; the cube is never at the goal at the start. With probability
    `start_near` an episode begins with the gripper 5.5 to 20 cm from the cube in any direction, half of the time on the
    floor, else up to 10 cm above it.

    Observation: object_position (3, m), object_rotation (6, two columns of its matrix), object_velocity (3, m/s),
    object_angular_velocity (3, rad/s), object_from_tool (3, m).
    Action: the robot's, without the gripper.
    Goals: achieved, the cube's position (3, m); desired, the goal position (3, m).
    Reward: sparse -1 until the goal is reached, then 0; dense minus the distance in m.
    What counts as success: the centre of the cube lies within `threshold` of the goal.
    Termination: never; the episode is truncated after `max_steps`.
    """

    class Settings(PointGoalSettings, CubeSettings):
        start_near: Probability = start("the gripper near the cube")

    settings: Settings
    drawn: Settings
    uses_gripper = False
    protective_stop = False  # a learning policy presses on cube and floor
    achieved_goal = Layout((Field("object_position", 3, "m", kind="point"),))

    def fit(self, robot: RobotView) -> None:
        self._robot = robot
        half = self.settings.object_size / 2
        self.ground = ground(robot.workspace, self.settings.goals, half, margin=half + CUBE_MARGIN)
        # a cube that is not lost is at most 10 m away, and a goal lies in the workspace
        self._fit_goal(self.ground, span=LOST_DISTANCE + 2 * robot.workspace.diagonal)

    def reset(self, generator: Generator) -> None:
        position: Vector = tuple(sample_position(generator, self.ground, "the cube").tolist())
        self.stage = drawn_stage(self.drawn, generator.uniform(), "near")
        if self.stage:
            self.cube.place_with_tool(self._robot, position, near_start(self._robot, position, generator), 0.0)
        else:
            self.cube.place(position, aligned(self._robot))
        self._sample_goal(generator, self.ground)

    def achieved(self) -> FloatArray:
        return np.array(self.cube.position, np.float32)

    def expert(self) -> Expert:
        return PushExpert(self._robot, self, self.settings.threshold)


def near_start(
    robot: RobotView,
    cube: Vector,
    generator: Generator,
    angles: tuple[float, float] = (-pi, pi),
    distances: tuple[float, float] = NEAR_DISTANCES,
    height: float = NEAR_HEIGHT,
) -> Vector:
    """A random position (x, y, z) of the tool in m, near the cube and within the workspace.

    Args:
        angles: range in rad of its direction from the cube, from the x axis.
        distances: range in m of its distance along the floor. At the usual ones it does not touch the cube.
        height: largest height in m above the floor. Half of the positions are on the floor.
    """
    (x, y, _), box = cube, robot.workspace
    angle, distance = generator.uniform(*angles), generator.uniform(*distances)
    above = max(0.0, generator.uniform(-height, height))
    return (
        min(max(x + distance * cos(angle), box.low[0]), box.high[0]),
        min(max(y + distance * sin(angle), box.low[1]), box.high[1]),
        min(box.low[2] + PUSHING_CLEARANCE + above, box.high[2]),
    )


CROSSING_HEIGHT = 0.065
"""Height in m above the floor at which the gripper crosses the cube."""
ALIGNED_DISTANCE = 0.015
"""Distance in m from its place behind the cube at which the gripper may go down."""
PUSHING_CLEARANCE = 0.004
"""Height in m above the lowest position of the tool at which it pushes, so that it does not rub on the floor."""
DONE_SHARE = 0.5
"""Fraction of the threshold at which the cube is left alone."""


class PushExpert(Expert):
    """Goes behind the cube as seen from the goal, down, then straight to the goal. Restarts when it slips."""

    def __init__(self, robot: RobotView, task: CubeTask, threshold: float) -> None:
        self._robot = robot
        self._task = task
        self._threshold = threshold
        self._pushing = False

    def reset(self) -> None:
        self._pushing = False

    def act(self) -> FloatArray:
        robot, task = self._robot, self._task
        (x, y, z), (gx, gy, *_) = task.cube.position, task.goal.tolist()
        distance = hypot(gx - x, gy - y)
        if distance < DONE_SHARE * self._threshold:
            return robot.towards(robot.tool_position, 0.0)
        ux, uy = (gx - x) / distance, (gy - y) / distance
        low = max(z, robot.workspace.low[2] + PUSHING_CLEARANCE)
        along, way = self._behind(ux, uy, low)
        if way is not None:
            return robot.towards(way, 0.0)
        ahead = along + min(0.3 * distance, robot.tool_step)  # slowly: a cube that is hit slides on
        # back onto the line through cube and goal
        return robot.towards((x + ux * ahead, y + uy * ahead, low), 0.0)

    def _behind(self, ux: float, uy: float, low: float) -> tuple[float, Vector | None]:
        """Distance in m of the tool ahead of the cube along (ux, uy), and the way behind it; None: it is there."""
        robot, (x, y, _), (tx, ty, tz) = self._robot, self._task.cube.position, self._robot.tool_position
        # position of the tool relative to the cube, along and across the direction of the push
        along, across = (tx - x) * ux + (ty - y) * uy, (ty - y) * ux - (tx - x) * uy
        if self._pushing and (along > 0 or abs(across) > 0.02):
            self._pushing = False
        if not self._pushing:
            start = self._start(ux, uy, low)
            error = hypot(tx - start[0], ty - start[1])
            high = tz > CROSSING_HEIGHT - 0.02
            if error > ALIGNED_DISTANCE or (high and drift(robot) > ALIGNED_DISTANCE / 2):
                above: Vector = (start[0], start[1], CROSSING_HEIGHT)
                if high:
                    return along, braking(robot, above)
                return along, braking(robot, above if error < 0.04 else (tx, ty, CROSSING_HEIGHT))
            if tz - low > 0.012:
                return along, braking(robot, start)
            self._pushing = True
        return along, None

    def _start(self, ux: float, uy: float, low: float) -> Vector:
        """Position of the tool from which it pushes along (ux, uy): behind the cube, within the workspace."""
        (x, y, _), box = self._task.cube.position, self._robot.workspace
        behind = self._task.settings.object_size / 2 + 0.04
        return (
            min(max(x - ux * behind, box.low[0]), box.high[0]),
            min(max(y - uy * behind, box.low[1]), box.high[1]),
            low,
        )
