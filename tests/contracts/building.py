"""Building blocks of the contract tests: every robot with every task, as the registry knows them."""

from __future__ import annotations

from typing import Any

from karolos.environments.build import build_environment
from karolos.environments.robot_task import RobotTask
from karolos.registry import load, names
from karolos.spec.recipe import Part, Recipe

CONTROLS = ("joint", "cartesian")
PAIRS = [(robot, task) for robot in names("robots") for task in names("tasks")]


def goes_with(task: str, control: str) -> bool:
    """Cartesian control keeps the tool pointing down, which not every task can be done with."""
    return control == "joint" or bool(load("tasks", task).points_down)


def part(kind: str, name: str, **settings: Any) -> Part:
    return Part(kind, name, load(kind, name).Settings(**settings))


def robot_task(
    robot: str = "panda", task: str = "reach", *, control: str | None = None, randomization: Any = (), **settings: Any
) -> RobotTask:
    """A robot with a task; further settings are the task's."""
    environment = build_environment(
        Recipe(
            environment=part("environments", "robot_task"),
            robot=part("robots", robot, control=control),
            task=part("tasks", task, **settings),
            randomization=randomization,
        )
    )
    assert isinstance(environment, RobotTask)
    return environment
