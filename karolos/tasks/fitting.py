"""Whether a task's settings go with a robot: the checks that tasks share."""

from __future__ import annotations

from ..errors import PluginError, UsageError
from ..simulation.interface import Box, Gripper, RobotView

AREA = 0.3
"""Edge in m of the square in the middle of the workspace in which cube and goal lie, as in panda-gym."""


def fitting_gripper(robot: RobotView, task: str, size: float) -> Gripper:
    """The robot's gripper, wide enough for an object of `size` m.

    Raises:
        PluginError: the robot has no gripper.
        UsageError: the object is too large for it.
    """
    gripper = robot.gripper
    if gripper is None:
        raise PluginError("this robot has no gripper", where=type(robot).__name__, hint=f"{task} grasps")
    if size > 0.9 * gripper.width:
        raise UsageError(
            f"a cube of {size:g} m does not go into the gripper",
            where="task.object_size",
            hint=f"it opens {gripper.width:g} m; a tenth of that is needed as play",
        )
    return gripper


def fitting_threshold(threshold: float, box: Box) -> None:
    """Raises UsageError when a goal anywhere in the box may be reached wherever the object is."""
    if 2 * threshold >= box.diagonal:
        raise UsageError(
            f"{threshold:g} m leaves no goal to reach",
            where="task.threshold",
            hint=f"goals lie in a box with a diagonal of {box.diagonal:.2f} m; take a smaller threshold",
        )


def surface(workspace: Box, goals: str, height: float, *, margin: float = 0.0) -> Box:
    """The part of the floor, at `height` m, where a cube and its goal may lie, in the middle of the workspace.

    Args:
        goals: `box`, a square of `AREA`, or `workspace`, all of it.
        margin: room in m that is left to the edge of the workspace on every side, whatever `goals` is.

    Raises UsageError when the tool cannot be that low, or the margin leaves nothing.
    """
    if not workspace.low[2] <= height <= workspace.high[2]:
        raise UsageError(
            f"the tool cannot be {height:g} m above the floor, where the object lies",
            where="task.object_size",
            hint=f"its workspace is {workspace.low[2]:g} to {workspace.high[2]:g} m high",
        )
    x, y = (workspace.high[axis] - workspace.low[axis] - 2 * margin for axis in (0, 1))
    if min(x, y) <= 0:
        raise UsageError(
            f"no room is left around the object: {margin:g} m are needed on every side of it",
            where="task.object_size",
            hint=f"the workspace is {x + 2 * margin:.2f} by {y + 2 * margin:.2f} m; take a smaller object",
        )
    box = workspace.middle((x, y, 1.0) if goals == "workspace" else (min(x, AREA), min(y, AREA), 1.0))
    return Box((*box.low[:2], height), (*box.high[:2], height))
