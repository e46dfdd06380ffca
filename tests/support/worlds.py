"""Transitions whose numbers identify them, and a reference that stores all of them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from karolos.core import Array, Batch, BoolArray, Field, FloatArray, GoalRule, Layout, Signature, Transitions
from karolos.core.seeding import SeedTree


class SameStep(GoalRule):
    """A goal is [episode, step]; it is reached by exactly that, which is worth 1 and may end the episode."""

    reward_range = (0.0, 1.0)

    def __init__(self, *, ends: bool = False) -> None:
        self.ends = ends

    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        return self.success(achieved, desired).astype(np.float32)

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        return np.asarray((achieved[..., :2] == desired).all(-1))

    def terminated(self, achieved: Array, desired: Array) -> BoolArray:
        reached = self.success(achieved, desired)
        return reached if self.ends else np.zeros_like(reached)


def counting_signature(max_steps: int, *, rule: GoalRule | None = None) -> Signature:
    """Observation [environment, episode, step]; achieved goal [episode, step, -1]; desired goal two columns of it."""
    return Signature(
        observation=Layout((Field("place", 3),)),
        action=Layout((Field("action", 2),)),
        max_steps=max_steps,
        reward_range=(0.0, 1.0),
        achieved_goal=Layout((Field("reached", 2), Field("more", 1))),
        desired_goal=Layout((Field("goal", 2),)),
        goal_rule=rule or SameStep(),
    )


class Counting:
    """Environments that count: feeds a buffer, and records what it gave."""

    def __init__(self, environments: int) -> None:
        self.episodes = 0
        self.current = [self.begin() for _ in range(environments)]
        self.given: list[list[tuple[int, int]]] = [[] for _ in range(environments)]
        """(episode, step) of every transition, by environment."""

    def begin(self) -> list[int]:
        self.episodes += 1
        return [self.episodes, 0]

    def step(self, environments: Sequence[int], *, over: Sequence[bool], fallen: bool = False) -> Transitions:
        """One transition of each environment; `over`: it is the episode's last (terminated for no goal if `fallen`)."""
        n = len(environments)
        observation = np.zeros((n, 3), np.float32)
        following = np.zeros((n, 3), np.float32)
        for row, environment in enumerate(environments):
            episode, step = self.current[environment]
            observation[row] = environment, episode, step
            following[row] = environment, episode, step + 1
            self.given[environment].append((episode, step))
            self.current[environment] = self.begin() if over[row] else [episode, step + 1]
        more = np.full((n, 1), -1, np.float32)
        ended = np.array(over, np.bool_)
        return Transitions(
            environment=np.array(environments, np.int64),
            observation=observation,
            achieved_goal=np.hstack((observation[:, 1:], more)),
            desired_goal=np.full((n, 2), -7, np.float32),
            action=np.tile(np.float32([0.25, -0.5]), (n, 1)),
            reward=np.zeros(n, np.float32),
            next_observation=following,
            next_achieved_goal=np.hstack((following[:, 1:], more)),
            terminated=ended & fallen,
            truncated=ended & (not fallen),
        )

    def stored(self, ring_size: int) -> set[tuple[int, int]]:
        """(episode, step) of every transition that a buffer with rings of this size still holds."""
        return {place for given in self.given for place in given[-ring_size:]}


def make_buffer(
    buffer: Any, signature: Signature, capacity: int, *, environments: int = 1, discount: float = 0.9, **settings: Any
) -> Any:
    """An empty replay buffer of this class."""
    chosen = buffer.Settings.model_validate({"capacity": capacity, **settings})
    return buffer(chosen, signature, SeedTree(3), environments=environments, discount=discount)


def feed(buffer: Any, world: Counting, steps: int, *, length: int = 5, fallen: bool = False) -> None:
    """Store steps of all environments, in episodes of `length` steps."""
    everyone = range(len(world.current))
    for step in range(steps):
        buffer.add(world.step(everyone, over=[step % length == length - 1] * len(everyone), fallen=fallen))


def places(batch: Batch) -> list[tuple[int, int]]:
    """(episode, step) of each transition."""
    return [(int(episode), int(step)) for _, episode, step in batch.observation]


def goals(batch: Batch) -> list[tuple[int, int]]:
    """(episode, step) that each goal asks for."""
    return [(int(episode), int(step)) for episode, step in batch.desired_goal]
