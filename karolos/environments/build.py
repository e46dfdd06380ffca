"""Builds an environment from a recipe, and collects the facts of an environment that a policy relies on."""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from itertools import product
from math import isclose
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from ..core import Array, Environment, Expert, Field, FloatArray, Layout, SeedTree, Signature, Step, layout_differences
from ..core.environment import close
from ..errors import PluginError, UsageError
from ..registry import blaming
from ..simulation.engines import ENGINES, PhysicsEngine
from ..specification.parts import Part, Recipe, validate_strictly
from .distributions import Choice
from .robot_task import RobotTask


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
        UsageError: a robot or task is missing, or given to an environment that takes none; randomization names a
            parameter that cannot be sampled; or robot and task are incompatible.
        PluginError: a plugin fails, or ends the program.
    """
    try:
        return _build(recipe)
    except SystemExit as error:
        raise _exited(recipe.environment.name, error) from error


def engine_of(environment: Part) -> PhysicsEngine | None:
    """The physics engine of a robot with a task; None for another environment."""
    settings = environment.settings
    return ENGINES[settings.engine] if isinstance(settings, RobotTask.Settings) else None


def _exited(name: str, error: SystemExit) -> PluginError:
    what = f"{name} ends the program: sys.exit({'' if error.code is None else repr(error.code)})"
    return PluginError(what, setting="environment", hint="a plugin raises an error instead")


@blaming()
def _build(recipe: Recipe) -> Environment:
    part = recipe.environment
    if part.name != "robot_task":
        if recipe.robot or recipe.task or recipe.randomization:
            raise UsageError(f"environment {part.name!r} takes no robot, task or randomization", setting="environment")
        environment: Environment = part.make()
        return environment
    joined, distributions = _join(recipe), dict(recipe.randomization)
    fixed = [name for name in distributions if name not in joined.declared and is_setting(recipe, name)]
    live = {name: part.make() for name, part in distributions.items() if name not in fixed}
    if not fixed:
        joined.randomize(live)
        return joined
    variants = {values: _join(variant) for values, variant in recipes(recipe, fixed).items()}
    for variant in variants.values():
        variant.randomize(live)
    drawn = next(iter(variants.values())).signature
    if differences := layout_differences(joined.signature, drawn, learning=True):  # tests sample nothing
        what = "tests, which draw nothing, would differ from training: " + "; ".join(differences)
        raise UsageError(what, setting=f"randomization.{fixed[0]}", hint="change the setting itself, too")
    return VariedRobotTask(variants, {name: distributions[name].make() for name in fixed})


def _join(recipe: Recipe) -> RobotTask:
    """The recipe's robot with its task, nothing randomized."""
    part = recipe.environment
    if recipe.robot is None or recipe.task is None:
        missing = "robot" if recipe.robot is None else "task"
        raise UsageError(f"no {missing} is given", setting="environment", hint="robot_task joins a robot and a task")
    joined: RobotTask = part.make(robot=recipe.robot.make(), task=recipe.task.make())
    return joined


MOST_WORLDS = 32
"""Largest number of combinations of values. Each needs a world of 29 MB with PyBullet, 1.4 MB with MuJoCo."""


class VariedRobotTask(Environment):
    """A robot task for each combination of settings; an episode takes place in one of them.

    Parameters of domain randomization change in a built world. Settings that are fixed in it, such as the shape of a
    body, vary here: each combination has a world of its own, built at its first episode.

    Args:
        variants: the robot tasks, by the values of the settings.
        distributions: of each setting ("task.object_size"), in the order of the values.

    Raises UsageError if a signature differs between the settings.
    """

    def __init__(self, variants: Mapping[tuple[float, ...], RobotTask], distributions: Mapping[str, Choice]) -> None:
        self._variants = variants
        self._distributions = distributions
        self._drawn, self._current = next(iter(variants.items()))
        signature, names = self._current.signature, list(distributions)
        for values, variant in variants.items():  # the first different one differs in one setting
            differences = layout_differences(variant.signature, signature, learning=True)
            if not differences and _rules(variant.signature) != _rules(signature):
                differences = ["episodes have another length, or another rule of reward and success"]
            if differences:
                index = next(index for index, value in enumerate(values) if value != self._drawn[index])
                raise UsageError(
                    "a sampled setting must not change observations, actions, goals and rewards: "
                    + "; ".join(differences),
                    setting=f"randomization.{names[index]}",
                    hint=f"give it one value: {names[index]}={self._drawn[index]:g}",
                )
        settings = Layout(tuple(Field(name, 1) for name in names))
        self.signature = replace(signature, parameters=signature.parameters + settings)
        self.rate = self._current.rate

    def reset(self, seed: int) -> Step:
        # a separate generator: starts, goals and the other parameters are those of an episode without it
        generator = SeedTree(seed).child("settings").generator()
        self._drawn = tuple(one.draw(generator) for one in self._distributions.values())
        self._current = self._variants[self._drawn]
        return self._current.reset(seed)

    def step(self, action: Array) -> Step:
        return self._current.step(action)

    def expert(self) -> Expert:
        """As `RobotTask.expert`, but only for the current episode."""
        return self._current.expert()

    def parameters(self) -> FloatArray:
        return np.concatenate([self._current.parameters(), np.array(self._drawn, np.float32)])

    def measures(self) -> FloatArray:
        return self._current.measures()

    def render(self, width: int = 640, height: int = 480) -> NDArray[np.uint8]:
        return self._current.render(width, height)

    def film(self, pictures: int, width: int = 640, height: int = 480) -> Iterator[NDArray[np.uint8]]:
        return self._current.film(pictures, width, height)

    def close(self) -> None:
        for variant in self._variants.values():
            variant.close()


def is_setting(recipe: Recipe, name: str) -> bool:
    """Whether `name` ("task.object_size") is a setting of the recipe's robot or task."""
    key, _, field = name.partition(".")
    part = {"robot": recipe.robot, "task": recipe.task}.get(key)
    return part is not None and field in type(part.settings).model_fields


def recipes(recipe: Recipe, names: Sequence[str]) -> dict[tuple[float, ...], Recipe]:
    """The recipe with each combination of the values of these settings.

    Raises:
        UsageError: a distribution is not a list of values, a value is not allowed, or there are too many combinations.
    """
    distributions = dict(recipe.randomization)
    lists = []
    for name in names:
        drawn = distributions[name]
        if not isinstance(drawn.settings, Choice.Settings):
            raise UsageError(
                f"{name} is fixed in a built world, so it cannot be sampled by {drawn.name!r}",
                setting=f"randomization.{name}",
                hint="list values: {name: choice, values: [...]}; each has a world of its own",
            )
        lists.append(dict.fromkeys(drawn.settings.values))
    combinations = list(product(*lists))
    if len(combinations) > MOST_WORLDS:
        raise UsageError(
            f"these values make {len(combinations)} worlds",
            setting=", ".join(f"randomization.{name}" for name in names),
            hint=f"at most {MOST_WORLDS} are built in each environment; list fewer values",
        )
    found = {}
    for values in combinations:
        variant = recipe
        for name, value in zip(names, values, strict=True):
            key, _, field = name.partition(".")
            part: Part = getattr(variant, key)
            given = {**part.settings.model_dump(mode="json"), field: value}
            try:
                settings = validate_strictly(type(part.settings), given)
            except ValidationError as error:
                what = f"{name} cannot be {value:g}: {error.errors()[0]['msg']}"
                raise UsageError(what, setting=f"randomization.{name}") from error
            changed = Part(part.kind, part.name, settings)
            variant = replace(variant, robot=changed) if key == "robot" else replace(variant, task=changed)
        found[values] = variant
    return found


def _rules(signature: Signature) -> tuple[Any, ...]:
    return signature.max_steps, signature.reward_range, signature.extra_reward, pickle.dumps(signature.goal_rule)


Scale = tuple[str, tuple[float, ...]]
"""Unit of a field, and the change of each of its numbers in a control step with an action of 1."""


@dataclass(frozen=True)
class Facts:
    """The facts of an environment that a policy relies on. Picklable."""

    signature: Signature
    rate: float
    """Control steps per second."""
    scales: dict[str, Scale]
    """Scale of each field of the robot's action; empty if the robot has no facts."""
    base: str | None
    """Where the robot stands (its setting `base`), which determines positions; None if it has no such setting."""

    def __deepcopy__(self, _: object) -> Facts:
        """The same object, because it never changes: observations are copied often."""
        return self

    @classmethod
    def of(cls, environment: Environment) -> Facts:
        """The facts of an environment; nothing is simulated."""
        robot = getattr(environment, "robot", None)
        facts: dict[str, Any] = getattr(robot, "facts", dict)()
        scales = {one["name"]: (one["unit"], tuple(one["scale"])) for one in facts.get("action", ()) if "scale" in one}
        base = getattr(getattr(robot, "settings", None), "base", None)
        return cls(environment.signature, environment.rate, scales, base)

    def differences(self, trained: Facts) -> list[str]:
        """Reasons why a policy trained under `trained` does not fit here, one line each."""
        lines = layout_differences(self.signature, trained.signature)
        if not isclose(self.rate, trained.rate, rel_tol=1e-6):
            lines.append(f"there are {self.rate:g} actions per second here and {trained.rate:g} there")
        if None not in (self.base, trained.base) and self.base != trained.base:
            lines.append(f"positions are those of robot.base={self.base} here and of {trained.base} there")
        for name, (unit, moved) in self.scales.items():
            known, there = trained.scales.get(name, (unit, moved))
            for one, other in zip(moved, there, strict=False):
                if unit != known or not isclose(one, other, rel_tol=1e-6):
                    lines.append(f"an action of 1 in {name} is {one:.3g} {unit} here and {other:.3g} {known} there")
                    break
        return lines
