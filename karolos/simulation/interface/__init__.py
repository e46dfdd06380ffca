"""What robots and tasks are to each other and to the environment that joins them.

A robot and a task do not know each other: the task speaks to `RobotView` and nothing else, so any robot goes with any
task. Importing this needs no pybullet; a world is built when an environment is reset for the first time.
Units: m, s, kg, N, rad; float32 arrays; the world's frame has its origin at the robot's base, on the floor.
"""

from .box import Box
from .robot import Gripper, JointLimits, Robot, RobotView
from .task import Expert, Task

__all__ = ["Box", "Expert", "Gripper", "JointLimits", "Robot", "RobotView", "Task"]
