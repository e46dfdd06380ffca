"""Transitions whose numbers identify them, and a reference that stores all of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from karolos.core import Array, BoolArray, Field, FloatArray, GoalRule, Layout, Signature, Transitions


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
        self.current = [self._new() for _ in range(environments)]
        self.given: list[list[tuple[int, int]]] = [[] for _ in range(environments)]
        """(episode, step) of every transition, by environment."""

    def _new(self) -> list[int]:
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
            self.current[environment] = self._new() if over[row] else [episode, step + 1]
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
