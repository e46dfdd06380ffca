"""Plays episodes of a policy step by step, to watch or to score them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..core import Environment, FloatArray
from ..errors import UsageError
from ..records.results import MeasureMean, measure_means
from ..statistics.intervals import wilson
from .policies import Policy
from .testing import measured, test_seeds


@dataclass(frozen=True)
class Moment:
    """One step of an episode."""

    episode: int
    """From 0."""
    step: int
    """0 right after the reset."""
    success: bool
    over: bool
    """Whether the episode ends here."""
    total: float
    """Sum of the rewards so far."""
    environment: Environment
    """For pictures: `environment.render()`."""


@dataclass(frozen=True)
class Score:
    """Success over some episodes."""

    episodes: int
    success_any: float
    """Fraction of the episodes that reached the goal at some step."""
    success_end: float
    """Fraction of the episodes whose goal held at the last step."""
    low: float
    """Lower end of the 95 % Wilson interval of `success_end`."""
    high: float
    """Upper end."""
    steps: float | None
    """Mean step at which the goal was first reached, over the episodes that reached it; None without any."""
    measures: dict[str, MeasureMean]
    """By name."""


def play(environment: Environment, policy: Policy, *, episodes: int, seed: int) -> Iterator[Moment]:
    """Play the first `episodes` test episodes of `seed`; with `testing.seed` these are the run's test episodes."""
    for episode, episode_seed in enumerate(test_seeds(seed, episodes)):
        yield from play_one(environment, policy, episode, episode_seed)


def play_failures(
    environment: Environment, policy: Policy, *, episodes: int, seed: int, among: int = 1000
) -> Iterator[Moment]:
    """Play the first `episodes` failures among the first `among` test episodes of `seed`; the others are not shown.

    A failure is played twice: nobody can know before its end that it is one.

    Raises UsageError if the environment does not define success, or if none of these episodes fails.
    """
    if not environment.signature.has_success:
        raise UsageError("this environment does not define success", hint="leave out --failures")
    found = 0
    for episode, episode_seed in enumerate(test_seeds(seed, among)):
        [end] = deque(play_one(environment, policy, episode, episode_seed), maxlen=1)
        if not end.success:
            yield from play_one(environment, policy, episode, episode_seed)
            found += 1
        if found == episodes:
            return
    if not found:
        raise UsageError(f"none of the first {among:,} episodes fails", hint="leave out --failures")


def play_one(environment: Environment, policy: Policy, episode: int, seed: int) -> Iterator[Moment]:
    """Play the episode of this number, whose own seed is `seed`."""
    state = environment.reset(seed)
    policy.begin()
    step, total = 0, 0.0
    yield Moment(episode, step, bool(state.success), False, total, environment)
    over = False
    while not over:
        state = environment.step(policy.act(state))
        step, total = step + 1, total + float(state.reward)
        over = bool(state.terminated or state.truncated)
        yield Moment(episode, step, bool(state.success), over, total, environment)


def score(environment: Environment, policy: Policy, *, episodes: int, seed: int) -> Score:
    """Play the first `episodes` test episodes of `seed`."""
    first_successes: dict[int, int] = {}
    ends = 0
    measures: list[FloatArray] = []
    for moment in play(environment, policy, episodes=episodes, seed=seed):
        if moment.success:
            first_successes.setdefault(moment.episode, moment.step)
            ends += moment.over
        if moment.over:
            measures.append(environment.measures())
    low, high = wilson(ends, episodes)
    reached = len(first_successes)
    mean = sum(first_successes.values()) / reached if reached else None
    means = measure_means(measured(environment.signature.measures, np.array(measures)))
    return Score(episodes, reached / episodes, ends / episodes, low, high, mean, means)
