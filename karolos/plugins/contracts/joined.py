"""Environments of the checked plugins: an environment itself, or a robot with a task."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager, closing
from dataclasses import replace
from typing import Any

from ...core import Environment
from ...environments.robot_task import RobotTask
from ...errors import PluginError, UsageError
from .case import Candidate, candidate

CONTROLS = ("joint", "cartesian")
"""Control modes in which a robot is checked with every task."""
TURNING = ("pose", "impedance")
"""Control modes in which it is checked alone, and with tasks that need them."""


def opened(first: Candidate, task: Candidate | None = None) -> AbstractContextManager[Environment]:
    """An environment, or a robot with a task, until it is closed."""
    return closing(join(first, task) if task is not None else first.plugin(first.settled()))


def join(
    robot: Candidate,
    task: Candidate,
    *,
    drawn: Mapping[str, float] | None = None,
    substeps: int | None = None,
    **settings: Any,
) -> RobotTask:
    """A robot with a task. `drawn`: values that randomization gives to parameters. `settings`: of the task."""
    chosen = {"engine": robot.engine or task.engine, "substeps": substeps}
    environment = RobotTask(
        RobotTask.Settings.model_validate({name: value for name, value in chosen.items() if value is not None}),
        robot=robot.plugin(robot.settled()),
        task=task.plugin(task.settled(**settings)),
    )
    fixed = {name: candidate("distributions", "choice", values=(value,)) for name, value in (drawn or {}).items()}
    environment.randomize({name: one.plugin(one.settled()) for name, one in fixed.items()})
    return environment


def refusal(robot: Candidate, task: Candidate) -> str | None:
    """Why the task refuses the robot; None if they work together. Nothing is simulated."""
    robot.plugin(robot.settled())  # an error of these is not a refusal
    task.plugin(task.settled())
    try:
        join(robot, task).close()
    except (PluginError, UsageError) as error:
        return str(error)
    return None


def joined(robot: Candidate, task: Candidate, **how: Any) -> AbstractContextManager[RobotTask]:
    """`join` as a context, which closes the environment."""
    return closing(join(robot, task, **how))


def reaching(robot: Candidate) -> AbstractContextManager[RobotTask]:
    """A robot with the task reach, in episodes without a practical limit."""
    return joined(robot, candidate("tasks", "reach"), max_steps=100_000)


def controls(robot: Candidate) -> list[Candidate]:
    """The robot under each control mode; the robot itself if it has no setting `control`."""
    if "control" not in robot.plugin.Settings.model_fields:
        return [robot]
    return [under(robot, control) for control in CONTROLS]


def under(robot: Candidate, control: str) -> Candidate:
    """The robot under a control mode."""
    return replace(robot, settings={**robot.settings, "control": control})


def goes_with(task: Candidate, control: str | None) -> bool:
    """Whether the task works under a control mode. Cartesian control keeps the tool pointing down; joints are stiff."""
    if task.plugin.control == "impedance":
        return control not in ("cartesian", "joint")
    return control != "cartesian" or task.plugin.control == "cartesian"
