"""Demonstrations: episodes of a task's scripted expert, made uneven so that they show how to recover as well."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from ..core import Environment, FloatArray, Step, Transitions
from ..core.seeding import Generator, SeedTree
from ..environments.build import build_environment
from ..environments.robot_task import RobotTask
from ..errors import RunError, UsageError
from ..simulation.interface import Expert
from ..spec.model import Demonstrations
from ..spec.recipe import Recipe


@dataclass(frozen=True)
class Demonstrated:
    """What was collected, and what it took."""

    episodes: tuple[Transitions, ...]
    """Each with its steps along the leading axis; `environment` is 0."""
    success_ratio: float
    """Share of the episodes whose goal held at the last step."""
    seconds: float
    """Wall-clock."""

    @property
    def steps(self) -> int:
        return sum(len(episode.reward) for episode in self.episodes)


def collect(recipe: Recipe, settings: Demonstrations, seeds: SeedTree) -> Demonstrated:
    """Play the expert's episodes in an environment of their own.

    The expert sees where its noisy actions have led before it acts again. Episodes whose simulation diverged are left
    out, and as many others played.

    Args:
        recipe: of the environment, randomization included.
        settings: how many, and how noisy.
        seeds: the run's root.

    Raises:
        UsageError: the environment has no expert.
        RunError: most episodes diverge.
    """
    started = time.perf_counter()
    tree = seeds.child("demonstrations")
    environment = build_environment(recipe)
    episodes: list[Transitions] = []
    held = 0
    try:
        for index in range(2 * settings.episodes):
            node = tree.child(index)
            steps, actions = _play(environment, settings, node.child("episode").integer(), node.generator())
            if steps[-1].diverged:
                continue
            episodes.append(_transitions(steps, actions))
            held += bool(steps[-1].success)
            if len(episodes) == settings.episodes:
                break
        else:
            raise RunError("most demonstrations diverge", where="demonstrations", hint="lower demonstrations.noise")
    finally:
        environment.close()
    return Demonstrated(tuple(episodes), held / len(episodes), time.perf_counter() - started)


def expert_of(environment: Environment) -> Expert:
    """The scripted policy for this environment. Raises UsageError where there is none."""
    if not isinstance(environment, RobotTask):
        raise UsageError(
            "this environment has no expert that could demonstrate anything",
            where="demonstrations",
            hint="remove demonstrations, or name a robot and a task",
        )
    try:
        return environment.expert()
    except UsageError as error:
        raise UsageError(error.what, where="demonstrations", hint="remove demonstrations") from error


def _play(
    environment: Environment, settings: Demonstrations, seed: int, generator: Generator
) -> tuple[list[Step], list[FloatArray]]:
    """One episode: the steps, the reset's included, and the actions between them."""
    steps, actions = [environment.reset(seed)], []
    expert = expert_of(environment)
    expert.reset()
    while not (steps[-1].terminated or steps[-1].truncated):
        asked = np.asarray(expert.act(), np.float32)
        noisy = asked + settings.noise * generator.standard_normal(asked.shape, np.float32)
        drawn = generator.uniform(-1, 1, asked.shape)
        action = drawn if generator.random() < settings.random else np.clip(noisy, -1, 1)
        actions.append(action.astype(np.float32))
        steps.append(environment.step(actions[-1]))
    return steps, actions


def _transitions(steps: list[Step], actions: list[FloatArray]) -> Transitions:
    before, after = steps[:-1], steps[1:]

    def flags(name: str) -> np.ndarray:
        return np.array([getattr(step, name) for step in after], np.bool_)

    return Transitions(
        environment=np.zeros(len(actions), np.int64),
        observation=np.stack([step.observation for step in before]),
        achieved_goal=np.stack([step.achieved_goal for step in before]),
        desired_goal=np.stack([step.desired_goal for step in before]),
        action=np.stack(actions),
        reward=np.array([step.reward for step in after], np.float32),
        next_observation=np.stack([step.observation for step in after]),
        next_achieved_goal=np.stack([step.achieved_goal for step in after]),
        terminated=flags("terminated"),
        truncated=flags("truncated"),
    )
