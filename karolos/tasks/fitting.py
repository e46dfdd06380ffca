"""Whether a task's settings go with a robot: the checks that tasks share."""

from __future__ import annotations

from ..errors import PluginError, UsageError
from ..simulation.interface import Box, Gripper, RobotView


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


def surface(workspace: Box, edge: float | None, height: float) -> Box:
    """The part of the floor, `height` m above it, in the middle of the workspace: a square of `edge` m, or all of it.

    Raises UsageError when the tool cannot be that low.
    """
    if not workspace.low[2] <= height <= workspace.high[2]:
        raise UsageError(
            f"the tool cannot be {height:g} m above the floor, where the object lies",
            where="task.object_size",
            hint=f"its workspace is {workspace.low[2]:g} to {workspace.high[2]:g} m high",
        )
    box = workspace if edge is None else workspace.middle((edge, edge, 1.0))
    return Box((*box.low[:2], height), (*box.high[:2], height))
