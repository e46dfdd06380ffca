"""How scripted policies bring a tool near things without knocking them over: slowly, and once it has come to rest."""

from __future__ import annotations

from math import dist, hypot

from ..simulation.body import Vector
from ..simulation.interface import RobotView

SLOW = 0.4
"""Share of the largest tool step. Faster, some joints reach the limits of what they can do before others, and the tool
leaves the straight line by centimetres."""
SHARE = 0.5
"""Of the way that is left, gone in one control step: an arm at full speed needs two steps to brake."""


def drift(robot: RobotView) -> float:
    """How far in m the tool goes level in a control step at the speed it has."""
    return hypot(robot.tool_velocity[0], robot.tool_velocity[1]) * robot.period


def braking(robot: RobotView, target: Vector, *, fastest: float = 1.0) -> Vector:
    """A point in m on the way to `target`, near enough that the tool slows down before it is there.

    Args:
        fastest: length of the way to that point at the most, as a share of the largest tool step.
    """
    way = dist(robot.tool_position, target)
    share = min(SHARE, fastest * robot.tool_step / max(way, 1e-9))
    x, y, z = (now + share * (goal - now) for now, goal in zip(robot.tool_position, target, strict=True))
    return x, y, z


def gently(robot: RobotView, target: Vector) -> Vector:
    """As `braking`, slowly enough that the tool goes straight: near things."""
    return braking(robot, target, fastest=SLOW)
