"""The interfaces between an engine, a robot, a task and the environment that joins them.

A task uses `RobotView` and nothing else of a robot, so any robot works with any task. Robots and tasks use `World`,
`Body` and `Motors` and nothing else of an engine.
Units: m, s, kg, N, rad. The world's frame has its origin on the floor, at the robot's base or, with `robot.base:
centred`, below the middle of its workspace.
"""

from ..geometry import Box
from .engine import Body, Camera, Cup, Fingers, Gripper, JointLimits, Motors, Stroke, World
from .robot import Robot, RobotView, TaskNeeds
from .task import Task

__all__ = [
    "Body",
    "Box",
    "Camera",
    "Cup",
    "Fingers",
    "Gripper",
    "JointLimits",
    "Motors",
    "Robot",
    "RobotView",
    "Stroke",
    "Task",
    "TaskNeeds",
    "World",
]
