"""Demonstrations: noisy episodes of a task's scripted expert, which also show recoveries, or recorded episodes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core import Environment, Expert, FloatArray, SeedTree, Step, Transitions
from ..environments.build import Facts, opened
from ..errors import RunError, UsageError
from ..recordings.reading import read_recordings
from ..specification.model import DemonstrationSettings
from ..specification.parts import Recipe


@dataclass(frozen=True)
class Demonstrations:
    """Episodes to learn from."""

    episodes: tuple[Transitions, ...]
    """Episodes, each with its steps along the leading axis; `environment` is 0."""
    success_end: float
    """Fraction of the episodes whose goal held at the last step."""
    seconds: float
    """Wall-clock seconds of collecting."""

    @property
    def steps(self) -> int:
        return sum(len(episode.reward) for episode in self.episodes)


def collect_demonstrations(
    recipe: Recipe,
    settings: DemonstrationSettings,
    seeds: SeedTree,
    on_step: Callable[[int], object] = lambda _: None,
) -> Demonstrations:
    """Read recorded episodes, or play episodes of the expert in a separate environment.

    The expert sees the effect of its noisy actions before it acts again. An episode whose simulation diverged is
    replaced by another one.

    Args:
        recipe: of the environment, with randomization.
        settings: number of episodes and size of the noise.
        on_step: is called with the number of collected episodes before each step. An error that it raises is passed on.

    Raises:
        UsageError: the environment has no expert, or the recording does not fit.
        RunError: most episodes diverge.
    """
    started = time.perf_counter()
    if settings.file is not None:
        with opened(recipe) as environment:
            facts = Facts.of(environment)
        read = read_recordings(Path(settings.file), facts, settings.columns, settings.episodes, on_step)
        success = read.successes / len(read.episodes)
        return Demonstrations(read.episodes, success, time.perf_counter() - started)
    tree = seeds.child("demonstrations")
    episodes: list[Transitions] = []
    successes = 0
    with opened(recipe) as environment:
        for index in range(2 * settings.episodes):
            node = tree.child(index)
            steps, actions = _play(environment, settings, node, lambda: on_step(len(episodes)))
            if steps[-1].diverged:
                continue
            episodes.append(_transitions(steps, actions))
            successes += bool(steps[-1].success)
            if len(episodes) == settings.episodes:
                break
        else:
            raise RunError("most demonstrations diverge", setting="demonstrations", hint="lower demonstrations.noise")
    return Demonstrations(tuple(episodes), successes / len(episodes), time.perf_counter() - started)


def check_demonstrations(recipe: Recipe, settings: DemonstrationSettings) -> None:
    """Raise a UsageError if there is no expert, or the recording does not fit."""
    if settings.file is not None:
        collect_demonstrations(recipe, settings, SeedTree(0))
        return
    with opened(recipe) as environment:
        demonstrating_expert(environment)


def demonstrating_expert(environment: Environment) -> Expert:
    """The scripted expert of the environment's task. Raises UsageError if it has none."""
    try:
        return environment.expert()
    except UsageError as error:
        raise UsageError(error.what, setting="demonstrations", hint="remove demonstrations") from error


def _play(
    environment: Environment, settings: DemonstrationSettings, node: SeedTree, on_step: Callable[[], object]
) -> tuple[list[Step], list[FloatArray]]:
    """One episode: its n + 1 steps, the reset's first, and its n actions."""
    generator, actions = node.generator(), []
    steps = [environment.reset(node.child("episode").integer())]
    expert = demonstrating_expert(environment)
    expert.reset()
    while not (steps[-1].terminated or steps[-1].truncated):
        on_step()
        intended = np.asarray(expert.act(), np.float32)
        noisy = intended + settings.noise * generator.standard_normal(intended.shape, np.float32)
        uniform = generator.uniform(-1, 1, intended.shape)
        action = uniform if generator.random() < settings.random else np.clip(noisy, -1, 1)
        actions.append(action.astype(np.float32))
        steps.append(environment.step(actions[-1]))
    return steps, actions


def _transitions(steps: list[Step], actions: list[FloatArray]) -> Transitions:
    played = Step(*(np.stack(column) for column in zip(*steps, strict=True)))
    return Transitions(
        environment=np.zeros(len(actions), np.int64),
        observation=played.observation[:-1],
        achieved_goal=played.achieved_goal[:-1],
        desired_goal=played.desired_goal[:-1],
        action=np.stack(actions),
        reward=played.reward[1:].astype(np.float32),
        next_observation=played.observation[1:],
        next_achieved_goal=played.achieved_goal[1:],
        terminated=played.terminated[1:].astype(np.bool_),
        truncated=played.truncated[1:].astype(np.bool_),
    )
