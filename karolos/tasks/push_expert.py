"""The scripted policy for push."""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING

from ..core import FloatArray
from ..simulation.body import Vector
from ..simulation.interface import Expert, RobotView
from .approach import braking, drift, gently

if TYPE_CHECKING:
    from .push import Push

HIGH = 0.08
"""m above the surface at which the gripper crosses the cube."""
LEVEL = 0.015
"""m off its place behind the cube at which the gripper may go down."""
LIFT = 0.004
"""m above the lowest place of the tool at which it pushes, so that it does not rub on the floor."""
ENOUGH = 0.5
"""Share of the threshold at which the cube is left alone."""


class PushExpert(Expert):
    """Behind the cube as seen from the goal, down, then straight at the goal; anew when the cube slips aside."""

    def __init__(self, robot: RobotView, task: Push) -> None:
        self._robot = robot
        self._task = task
        self._pushing = False

    def reset(self) -> None:
        self._pushing = False

    def act(self) -> FloatArray:
        robot, task = self._robot, self._task
        (x, y, z), (gx, gy, _), (tx, ty, tz) = task.cube.position, task.goal.tolist(), robot.tool_position
        way = hypot(gx - x, gy - y)
        if way < ENOUGH * task.settings.threshold:
            return robot.towards((tx, ty, tz), 0.0)
        ux, uy = (gx - x) / way, (gy - y) / way
        # where the tool is, seen from the cube along and across the way
        along, across = (tx - x) * ux + (ty - y) * uy, (ty - y) * ux - (tx - x) * uy
        low = max(z, robot.workspace.low[2] + LIFT)
        if self._pushing and (along > 0 or abs(across) > 0.02):
            self._pushing = False
        if not self._pushing:
            start = self._start(ux, uy, low)
            off = hypot(tx - start[0], ty - start[1])
            high = tz > HIGH - 0.02
            if off > LEVEL or (high and drift(robot) > LEVEL / 2):
                above: Vector = (start[0], start[1], HIGH)
                if high:
                    return robot.towards(braking(robot, above, fastest=2.0), 0.0)
                return robot.towards(gently(robot, above if off < 0.04 else (tx, ty, HIGH)), 0.0)
            if tz - low > 0.012:
                return robot.towards(gently(robot, start), 0.0)
            self._pushing = True
        ahead = along + min(0.5 * way, 0.3 * robot.tool_step)  # gently: a cube that is hit slides on
        # back onto the line through cube and goal
        return robot.towards((x + ux * ahead, y + uy * ahead, low), 0.0)

    def _start(self, ux: float, uy: float, low: float) -> Vector:
        """Where the tool begins to push along (ux, uy): behind the cube, within the workspace."""
        (x, y, _), box = self._task.cube.position, self._robot.workspace
        behind = self._task.settings.object_size / 2 + 0.04
        return (
            min(max(x - ux * behind, box.low[0]), box.high[0]),
            min(max(y - uy * behind, box.low[1]), box.high[1]),
            low,
        )
