"""The scripted policy for push."""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING

from ..core import FloatArray
from ..simulation.body import Vector
from ..simulation.interface import Expert, RobotView

if TYPE_CHECKING:
    from .push import Push

HIGH = 0.08
"""m above the surface at which the gripper crosses the cube."""
ENOUGH = 0.3
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
        low = max(z, robot.workspace.low[2])
        behind = task.settings.object_size / 2 + 0.04
        if self._pushing and (along > 0 or abs(across) > 0.02):
            self._pushing = False
        if not self._pushing:
            start: Vector = (x - ux * behind, y - uy * behind, low)
            off = hypot(tx - start[0], ty - start[1])
            if off > 0.015:
                return (
                    robot.towards((start[0], start[1], HIGH), 0.0)
                    if tz > HIGH - 0.02 or off < 0.04
                    else robot.towards((tx, ty, HIGH), 0.0)
                )
            if tz - low > 0.012:
                return robot.towards(start, 0.0)
            self._pushing = True
        ahead = along + min(0.5 * way, 0.3 * robot.tool_step)  # gently: a cube that is hit slides on
        # back onto the line through cube and goal
        return robot.towards((x + ux * ahead, y + uy * ahead, low), 0.0)
