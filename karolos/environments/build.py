"""From a recipe to an environment."""

from __future__ import annotations

from typing import Any

from ..core import Environment
from ..errors import UsageError
from ..registry import load
from ..spec.parts import Part, Recipe


def build_environment(recipe: Recipe) -> Environment:
    """The environment of a recipe; nothing is simulated before its first reset.

    Raises:
        UsageError: a robot or task is missing, or given to an environment that takes none.
        PluginError: robot and task are incompatible, or a plugin fails to import.
    """
    part = recipe.environment
    plugin = load(part.kind, part.name)
    if part.name != "robot_task":
        if recipe.robot or recipe.task or recipe.randomization:
            raise UsageError(f"environment {part.name!r} takes no robot, task or randomization", where="environment")
        environment: Environment = plugin(part.settings)
        return environment
    if recipe.robot is None or recipe.task is None:
        missing = "robot" if recipe.robot is None else "task"
        raise UsageError(f"no {missing} is given", where="environment", hint="robot_task joins a robot and a task")
    joined: Environment = plugin(
        part.settings,
        robot=_instance(recipe.robot),
        task=_instance(recipe.task),
        randomization={name: _instance(distribution) for name, distribution in recipe.randomization},
    )
    return joined


def _instance(part: Part) -> Any:
    """An instance of the plugin that the registry holds under this name."""
    return load(part.kind, part.name)(part.settings)
