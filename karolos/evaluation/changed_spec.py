"""A saved policy under changed settings: another robot, other physics, randomization."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from math import ceil

from ..core import Environment, Signature
from ..core.signature import SAME_LAYOUTS, layout_differences
from ..environments.build import engine_of, opened, used
from ..environments.robot_task import RobotTask
from ..errors import UsageError, closest
from ..specification import Spec, spec_from_dict
from ..specification.tree import FILES, RANDOMIZATION
from .policies import environment_of, playable

CHANGEABLE = ("robot", "task", "environment", "randomization", "orchestrator")
"""Keys of a spec that define the environment of a test. The other keys define the training."""
PARTS = ("robot", "task")
"""Keys whose parameters an override may set like settings."""


def changed_spec(saved: Spec, overrides: Sequence[str], *, trained: Signature, randomize: bool = False) -> Spec:
    """The spec with overrides of its environment. Tests sample its `randomization`.

    If the run's engine is not installed, another one replaces it. If an arm has slow joints (`ArmModel.tool_step`),
    episodes become longer in the same proportion, unless an override sets their length. A warning says so.

    An override of a parameter that is not a setting, e.g. task.gravity=-5, replaces its distribution. Without
    `randomize` these are the only distributions.

    Args:
        saved: of the run.
        overrides: `path.to.key=value`, each below one of CHANGEABLE.
        trained: signature of the environment that the policy was trained in.
        randomize: whether the distributions of the run stay.

    Raises:
        SpecError: an override is not valid.
        UsageError: an override is about training, observations, actions or goals have another layout than in training,
            or there is nothing to randomize.
    """
    for override in overrides:
        root = _key(override).partition(".")[0]
        if root not in CHANGEABLE:
            hint = f"a test can change {', '.join(CHANGEABLE)}"
            if root == "testing":
                hint = "use --episodes; `karolos test` has --seed, too"
            raise UsageError(f"{override!r} changes the training, not the test", where="override", hint=hint)
    saved = playable(saved)
    parameters = _parameters(saved, overrides)
    own = [f"{RANDOMIZATION}.{text.strip()}" if _key(text) in parameters else text for text in overrides]
    spec = spec_from_dict(saved.dump(), own)
    if randomize and not spec.randomization:
        raise UsageError(
            "there is nothing to randomize",
            setting=RANDOMIZATION,
            hint="add a distribution: randomization.task.gravity='{name: normal, mean: -9.81, std: 0.5}'",
        )
    if not randomize and any(_key(override).startswith(RANDOMIZATION) for override in overrides):
        raise UsageError(
            "randomization is off in a test",
            setting=RANDOMIZATION,
            hint="set one parameter, e.g. task.gravity=-5; `karolos test --randomize` samples as in training",
        )
    if not randomize:
        spec = spec.model_copy(update={RANDOMIZATION: {key: spec.randomization[key] for key in sorted(parameters)}})
    with spec.located(), used(environment_of(spec, randomize=True)) as environment:
        if differences := layout_differences(environment.signature, trained):
            changed = [_key(text) for text in overrides if _key(text).startswith(("robot", "task", "environment"))]
            raise UsageError(
                "the policy was trained with other observations, actions or goals: " + "; ".join(differences),
                setting=[*changed, "environment"][0],
                hint=SAME_LAYOUTS if saved.robot else "the environment of a test has the same layouts as in training",
            )
        timed = any(_key(text) in ("task", "task.max_steps") for text in overrides)
        return spec if timed else _with_time(spec, environment)


def _with_time(spec: Spec, environment: Environment) -> Spec:
    """The spec, with longer episodes if the arm's joints are slower than those of the built-in arms.

    The scale of actions is that of training. (With smaller actions a policy is even slower: docs/what_was_tried.md.)
    """
    if not isinstance(environment, RobotTask) or spec.robot is None or spec.task is None:
        return spec
    own = getattr(getattr(environment.robot, "model", None), "tool_step", None)
    asked = min(environment.robot.tool_step, spec.robot.plugin.Settings.model_fields["tool_step"].default)
    if own is None or asked <= own:
        return spec
    usual, slower = environment.signature.max_steps, asked / own
    steps = ceil(usual * slower)
    warnings.warn(f"the arm is {slower:.1f} times slower: {steps} control steps instead of {usual}", stacklevel=3)
    return spec.having("task", max_steps=steps)


def engine_note(saved: Spec, played: Spec) -> str | None:
    """One line if a policy is played in another physics engine than it was trained in; None otherwise."""
    own, other = engine_of(saved.environment), engine_of(played.environment)
    if own is None or other is None or other == own:
        return None
    missing = "" if own.installed else ", which is not installed"
    return f"the policy learned in the engine {own.name}{missing}: it is played in {other.name}"


def _parameters(saved: Spec, overrides: Sequence[str]) -> set[str]:
    """The keys of overrides that are parameters of the robot or task and not settings."""
    naming = (*PARTS, *(f"robot.{setting}" for _, setting in FILES))
    named = spec_from_dict(saved.dump(), [text for text in overrides if _key(text).removesuffix(".name") in naming])
    parts = (("robot", named.robot), ("task", named.task))
    settings = {f"{key}.{name}" for key, part in parts if part for name in type(part.settings).model_fields}
    settings |= {f"{part}.name" for part in PARTS}

    def among(key: str, names: set[str]) -> bool:
        return key in names or ".".join(key.split(".")[:2]) in names  # e.g. robot.gripper for robot.gripper.name

    keys = {_key(text): text for text in overrides if _key(text).startswith(tuple(f"{part}." for part in PARTS))}
    others = {key: text for key, text in keys.items() if not among(key, settings)}
    if not others:
        return set()
    # Only robot and task together know their parameters.
    joined = spec_from_dict(saved.dump(), [text for text in overrides if _key(text) not in others])
    with opened(joined.recipe(randomize=False)) as environment:
        drawn = set(environment.declared) - settings if isinstance(environment, RobotTask) else set()
    for key, text in others.items():
        if not among(key, drawn) and (like := closest(key, drawn)):
            raise UsageError("no such key", where=f"override {text}", setting=key, hint=f"did you mean {like}?")
    return set(others) & drawn


def _key(override: str) -> str:
    return override.partition("=")[0].strip()
