"""A robot with a task, and an episode of its expert."""

from __future__ import annotations

from typing import Any

from karolos.core import Step
from karolos.environments.build import build_environment
from karolos.environments.robot_task import RobotTask
from karolos.registry import load
from karolos.spec.parts import Part, Recipe


def part(kind: str, name: str, **settings: Any) -> Part:
    return Part(kind, name, load(kind, name).Settings.model_validate(settings))


def made(
    task: str, robot: str = "panda", control: str = "cartesian", draws: dict[str, Part] | None = None, **settings: Any
) -> RobotTask:
    """`draws`: distributions by parameter; further settings are the task's."""
    environment = build_environment(
        Recipe(
            part("environments", "robot_task"),
            part("robots", robot, control=control),
            part("tasks", task, **settings),
            tuple(sorted((draws or {}).items())),
        )
    )
    assert isinstance(environment, RobotTask)
    return environment


def expert_episode(environment: RobotTask, seed: int) -> list[Step]:
    steps = [environment.reset(seed)]
    expert = environment.expert()
    expert.reset()
    while not (steps[-1].terminated or steps[-1].truncated):
        steps.append(environment.step(expert.act()))
    return steps
