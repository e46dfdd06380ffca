"""What every robot with a gripper promises of its grip."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ...core import Array
from ...environments.robot_task import RobotTask
from ...tasks.reach import Reach
from .case import Candidate, demand, demand_same
from .joined import joined


class Grasping(Reach):
    """Reach with a gripper that opens and closes."""

    uses_gripper = True


def a_gripped_cube_survives_a_shake_alike_in_a_fresh_and_a_reused_world(one: Candidate) -> None:
    """A cube of 4 cm and .1 kg is held through a shake of 1 s, the same way in any world."""
    with _grasping(one) as used, _grasping(one) as fresh:
        poses, creep, apart = _shaken_cube(used)
        demand(creep < 0.002, f"the cube creeps {1000 * creep:.1f} mm in the gripper")
        demand(apart < 0.001, f"the fingers are {1000 * apart:.1f} mm apart from each other's place")
        demand_same(_shaken_cube(used)[0], poses, "the cube's poses in a world that was used before")
        demand_same(_shaken_cube(fresh)[0], poses, "the cube's poses in a fresh world")


PROMISES = (a_gripped_cube_survives_a_shake_alike_in_a_fresh_and_a_reused_world,)


@contextmanager
def _grasping(one: Candidate) -> Iterator[RobotTask]:
    with joined(one, Candidate("tasks", "grasping", Grasping), max_steps=1000) as environment:
        yield environment


def _shaken_cube(made: Any) -> tuple[Array, float, float]:
    """Grip the cube, lift it and shake it.

    Returns its poses (steps, 7) and, of the shake, its creep in the gripper and the fingers' largest difference in m.
    """
    made.reset(0)
    robot: Any = made.robot
    if not hasattr(made, "cube"):
        made.cube = made.world.box((0.04, 0.04, 0.04), 0.1, (0.9, 0.4, 0.1, 1.0))
    cube = made.cube
    x, y, _ = robot.workspace.centre
    cube.place((x, y, 0.02))
    poses: list[tuple[float, ...]] = []

    def step(action: Array) -> None:
        made.step(action)
        position, turn = cube.pose()
        poses.append((*position, *turn))

    top = min(0.3, robot.workspace.high[2])
    for height, opening, count in ((0.02, 1.0, 30), (0.02, 0.0, 14), (top, 0.0, 20)):
        for _ in range(count):
            step(robot.towards((x, y, height), opening))
    demand(robot.pads_touching(cube) == 2, "the cube has slipped out while it was lifted")

    def held() -> Array:
        tool = robot._configuration.tool
        found: Array = np.array([tool.x, tool.y, tool.z]) @ np.subtract(cube.pose()[0], tool.position)
        return found

    before, apart = held(), 0.0
    fingers = robot._motors.pads
    for shake in range(24):
        step(np.array([0.0, 1.0 if shake % 2 else -1.0, 1.0 if shake % 4 < 2 else -1.0, -1.0]))
        first, second = robot.body.joints(fingers)
        apart = max(apart, abs(first[0] - second[0]))
    return np.array(poses), float(np.linalg.norm(held() - before)), apart
