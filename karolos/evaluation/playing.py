"""Watching a policy, a saved one without exploration or a scripted one: its episodes, one moment at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..core import Environment, Step
from ..environments.build import build_environment
from ..environments.robot_task import RobotTask
from ..errors import MachineError, UsageError
from ..records import RunFolder
from ..spec import Spec
from ..spec.recipe import Recipe
from .policies import load_agent
from .testing import test_seeds


@dataclass(frozen=True)
class Policy:
    """What to do after a step: an action (a,)."""

    act: Callable[[Step], NDArray[np.float32]]
    begin: Callable[[], None] = lambda: None
    """Called after each reset."""


@dataclass(frozen=True)
class Moment:
    """One step of an episode that is played."""

    episode: int
    """From 0."""
    step: int
    """0 right after the reset."""
    success: bool
    over: bool
    """Whether the episode ends here."""
    environment: Environment
    """To take a picture of: `environment.render()`."""


def load_player(folder: RunFolder, name: str = "best", *, window: bool = False) -> tuple[Spec, Environment, Policy]:
    """The spec, one environment without randomization and the policy of a run's checkpoint.

    Args:
        folder: the run's.
        name: `best` or `last`.
        window: show the world in a window.

    Raises:
        RunError: the run has no such checkpoint, or it is damaged.
        MachineError: a window is asked for and there is no display.
    """
    saved = load_agent(folder, name)
    spec, agent = saved.spec, saved.agent
    environment = _environment(spec, window)

    def policy(state: Step) -> NDArray[np.float32]:
        return np.asarray(agent.act(state.observation[None], state.desired_goal[None], explore=False)[0])

    return spec, environment, Policy(policy)


def load_expert(spec: Spec, *, window: bool = False) -> tuple[Environment, Policy]:
    """One environment of the spec without randomization, and the scripted policy of its task.

    Raises:
        UsageError: the spec has no robot and task, or the task has no expert.
        MachineError: a window is asked for and there is no display.
    """
    environment = _environment(spec, window)
    try:
        return environment, expert_policy(environment)
    except BaseException:
        environment.close()
        raise


def expert_policy(environment: Environment) -> Policy:
    """The scripted policy of the environment's task. Raises UsageError where there is none."""
    if not isinstance(environment, RobotTask):
        raise UsageError("there is no expert for this environment", where="environment", hint="tasks have experts")
    expert = environment.expert()

    def act(_: Step) -> NDArray[np.float32]:
        return np.asarray(expert.act(), np.float32)

    return Policy(act, expert.reset)


def _environment(spec: Spec, window: bool) -> Environment:
    recipe = spec.recipe(randomize=False)
    return build_environment(_in_a_window(recipe) if window else recipe)


def _in_a_window(recipe: Recipe) -> Recipe:
    part = recipe.environment
    if "window" not in type(part.settings).model_fields:
        raise MachineError(f"environment {part.name} has no window", hint="record a film with --record FILE.mp4")
    settings = part.settings.model_copy(update={"window": True})
    return replace(recipe, environment=replace(part, settings=settings))


def play(environment: Environment, policy: Policy, *, episodes: int, seed: int) -> Iterator[Moment]:
    """Play the first `episodes` test episodes under the root `seed`: with `testing.seed`, those it was tested on."""
    for episode, episode_seed in enumerate(test_seeds(seed, episodes)):
        state = environment.reset(episode_seed)
        policy.begin()
        step = 0
        yield Moment(episode, step, bool(state.success), False, environment)
        over = False
        while not over:
            state = environment.step(policy.act(state))
            step += 1
            over = bool(state.terminated or state.truncated)
            yield Moment(episode, step, bool(state.success), over, environment)
