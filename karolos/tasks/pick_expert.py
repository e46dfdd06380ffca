"""The scripted policy for pick and place."""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING

from ..core import FloatArray
from ..simulation.body import Vector
from ..simulation.interface import Expert, RobotView
from .approach import braking, drift, gently

if TYPE_CHECKING:
    from .pick_place import PickPlace

ABOVE = 0.08
"""m above the cube at which the gripper comes."""
LEVEL = 0.018
"""m off the cube's axis at which the gripper may go down; open, it has 1.5 cm to each side of a 4 cm cube."""
STILL = 0.015
"""m per control step, level, that the tool may drift when it goes down or closes."""
GRIP = 0.006
"""m above the middle of the cube at which it is gripped, so that the pads do not rub on the floor: fingers that do
stay where they are, and an arm that drags them along lags behind."""
CLEAR = 0.03
"""m above its place of rest at which the cube crosses to a goal on the surface: one that is dragged there twists out of
the pads."""
CLOSING = 3
"""Control steps for which both pads must touch before the cube is lifted: until then they push it to the middle."""
PATIENCE = 30
"""Control steps after which a gripper that has closed on nothing opens again."""


class PickExpert(Expert):
    """Over the cube, down, close, lift, bring to the goal. From the start again when the cube is lost on the way."""

    def __init__(self, robot: RobotView, task: PickPlace) -> None:
        self._robot = robot
        self._task = task
        self._wide = min(1.0, (1.5 * task.settings.object_size + 0.01) / task.gripper.width)  # a cube on its diagonal
        self._closing = 0
        self._held = 0

    def reset(self) -> None:
        self._held = CLOSING if self._around() else 0
        self._closing = self._held

    def _around(self) -> bool:
        """Whether the pads are about the cube; on its diagonal it is 1.42 times as wide as along its edges."""
        robot, cube, size = self._robot, self._task.cube.position, self._task.settings.object_size
        near = sum((a - b) ** 2 for a, b in zip(robot.tool_position, cube, strict=True)) < size**2
        return near and 0.8 * size < robot.opening * self._task.gripper.width < 1.45 * size

    def _holding(self) -> bool:
        """Whether the pads are about the cube, and both touched it before it was lifted."""
        return self._around() and (self._held >= CLOSING or self._robot.pads_touching(self._task.cube.body) == 2)

    def act(self) -> FloatArray:
        robot, (x, y, z), (tx, ty, tz) = self._robot, self._task.cube.position, self._robot.tool_position
        grip: Vector = (x, y, max(z + GRIP, robot.workspace.low[2]))
        if self._closing:
            self._closing += 1
            lifted = self._held > CLOSING
            self._held = self._held + 1 if self._holding() else 0
            if self._held > CLOSING:
                return robot.towards(self._bringing(), 0.0)
            if not lifted and self._closing < PATIENCE:
                return robot.towards((tx, ty, tz) if self._held else grip, 0.0)
            self._closing = 0
        off, above = hypot(tx - x, ty - y), z + ABOVE
        high = tz > z + ABOVE / 2
        if off > LEVEL or (high and drift(robot) > STILL):
            way = braking(robot, (x, y, above), fastest=2.0) if high else gently(robot, (tx, ty, above))
            return robot.towards(way, self._wide)
        if tz > grip[2] + 0.006 or drift(robot) > STILL:
            return robot.towards(gently(robot, grip), self._wide)
        self._closing = 1
        return robot.towards(grip, 0.0)

    def _bringing(self) -> Vector:
        """Where the tool has to go so that the cube, as it lies in the gripper, comes to the goal."""
        tool, cube, goal = self._robot.tool_position, self._task.cube, self._task.goal.tolist()
        x, y, z = (t + g - c for t, g, c in zip(tool, goal, cube.position, strict=True))
        if hypot(x - tool[0], y - tool[1]) > CLEAR:
            if cube.lowest < CLEAR / 3:
                return tool[0], tool[1], tool[2] + CLEAR
            z = max(z, tool[2] + CLEAR - cube.lowest)
        return x, y, max(z, self._robot.workspace.low[2])
