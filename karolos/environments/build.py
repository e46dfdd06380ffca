"""From a recipe to an environment."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from ..core import Environment
from ..core.environment import close
from ..core.signature import layout_differences
from ..errors import PluginError, UsageError
from ..registry import blaming, load
from ..specification.parts import Part, Recipe
from .robot_task import RobotTask
from .varied import VariedRobotTask, is_setting, recipes


@contextmanager
def used(environment: Environment) -> Iterator[Environment]:
    """Close an environment after the block. Raises PluginError if a plugin fails or ends the program in the block."""
    try:
        with blaming():
            yield environment
    except SystemExit as error:
        raise _exited(type(environment).__name__, error) from error
    finally:
        close(environment)


def opened(recipe: Recipe) -> AbstractContextManager[Environment]:
    """The environment of a recipe, which is closed after the block. Raises as `build_environment` and `used`."""
    return used(build_environment(recipe))


def build_environment(recipe: Recipe) -> Environment:
    """The environment of a recipe; nothing is simulated before its first reset.

    Raises:
        UsageError: a robot or task is missing, or given to an environment that takes none; randomization names what
            cannot be drawn.
        PluginError: robot and task are incompatible, or a plugin fails, or ends the program.
    """
    try:
        return _build(recipe)
    except SystemExit as error:
        raise _exited(recipe.environment.name, error) from error


def _exited(name: str, error: SystemExit) -> PluginError:
    what = f"{name} ends the program: sys.exit({'' if error.code is None else repr(error.code)})"
    return PluginError(what, setting="environment", hint="a plugin raises an error instead")


@blaming()
def _build(recipe: Recipe) -> Environment:
    part = recipe.environment
    if part.name != "robot_task":
        if recipe.robot or recipe.task or recipe.randomization:
            raise UsageError(f"environment {part.name!r} takes no robot, task or randomization", setting="environment")
        environment: Environment = _instance(part)
        return environment
    joined, distributions = _join(recipe), dict(recipe.randomization)
    fixed = [name for name in distributions if name not in joined.declared and is_setting(recipe, name)]
    live = {name: _instance(part) for name, part in distributions.items() if name not in fixed}
    if not fixed:
        joined.randomize(live)
        return joined
    variants = {values: _join(variant) for values, variant in recipes(recipe, fixed).items()}
    for variant in variants.values():
        variant.randomize(live)
    drawn = next(iter(variants.values())).signature
    if differences := layout_differences(joined.signature, drawn, learning=True):  # tests draw nothing
        what = "tests, which draw nothing, would differ from training: " + "; ".join(differences)
        raise UsageError(what, setting=f"randomization.{fixed[0]}", hint="change the setting itself, too")
    return VariedRobotTask(variants, {name: _instance(distributions[name]) for name in fixed})


def _join(recipe: Recipe) -> RobotTask:
    """The recipe's robot with its task, nothing randomized."""
    part = recipe.environment
    if recipe.robot is None or recipe.task is None:
        missing = "robot" if recipe.robot is None else "task"
        raise UsageError(f"no {missing} is given", setting="environment", hint="robot_task joins a robot and a task")
    plugin = load(part.kind, part.name)
    joined: RobotTask = plugin(part.settings, robot=_instance(recipe.robot), task=_instance(recipe.task))
    return joined


def _instance(part: Part) -> Any:
    """An instance of the plugin that the registry holds under this name."""
    return load(part.kind, part.name)(part.settings)
