"""The scripted policy for pick and place."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..core import FloatArray
from ..simulation.body import Vector
from ..simulation.interface import Expert, RobotView

if TYPE_CHECKING:
    from .pick_place import PickPlace

ABOVE = 0.08
"""m above the cube at which the gripper comes."""
LEVEL = 0.012
"""m off the cube's axis at which the gripper may go down."""
CLOSING = 5
"""Control steps after which a closed gripper is taken to hold, if its pads touch."""


class PickExpert(Expert):
    """Over the cube, down, close, bring to the goal. From the start again when the cube is lost on the way."""

    def __init__(self, robot: RobotView, task: PickPlace) -> None:
        self._robot = robot
        self._task = task
        self._closed = 0

    def reset(self) -> None:
        self._closed = CLOSING if self._holding() else 0

    def _holding(self) -> bool:
        away = [a - b for a, b in zip(self._robot.tool_position, self._task.cube.position, strict=True)]
        near = sum(value * value for value in away) ** 0.5 < self._task.settings.object_size
        shut = self._robot.opening < 1.15 * self._task.settings.object_size / self._task.gripper.width
        return near and shut

    def act(self) -> FloatArray:
        robot, cube = self._robot, self._task.cube.position
        if self._closed:
            self._closed += 1
            if self._closed > CLOSING and not self._holding():
                self._closed = 0
            elif self._closed > CLOSING:
                return robot.towards(self._bringing(), 0.0)
            else:
                return robot.towards(cube, 0.0)
        x, y, z = cube
        tool = robot.tool_position
        level = ((tool[0] - x) ** 2 + (tool[1] - y) ** 2) ** 0.5
        if level > LEVEL:
            return robot.towards(
                (x, y, max(z + ABOVE, 0.0)) if tool[2] > z + 0.04 else (tool[0], tool[1], z + ABOVE), 1.0
            )
        if tool[2] - z > 0.006:
            return robot.towards((x, y, z), 1.0)
        self._closed = 1
        return robot.towards((x, y, z), 0.0)

    def _bringing(self) -> Vector:
        """Where the tool has to go so that the cube, as it lies in the gripper, comes to the goal."""
        tool, cube = self._robot.tool_position, self._task.cube.position
        x, y, z = (t + g - c for t, g, c in zip(tool, self._task.goal.tolist(), cube, strict=True))
        return x, y, max(z, self._robot.workspace.low[2])
