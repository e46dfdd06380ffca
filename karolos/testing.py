"""Tests: episodes without exploration on fixed seeds, apart from training, counted honestly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .core import Agent, Orchestrator, Step
from .seeding import SeedTree


@dataclass(frozen=True)
class TestResult:
    """What one test found. The lists hold one entry per test seed, in the order of the seeds.

    `any`: the goal was reached at some step; `end`: it held at the last; `reset`: it held before the first action.
    """

    __test__ = False  # not a test case, whatever its name says to pytest

    steps: int
    """Environment steps of training before the test."""
    seconds: float
    """Wall-clock seconds of collecting and learning before the test; tests excluded."""
    any: tuple[bool, ...]
    end: tuple[bool, ...]
    reset: tuple[bool, ...]
    returns: tuple[float, ...]
    lengths: tuple[int, ...]

    @property
    def episodes(self) -> int:
        return len(self.any)

    @property
    def success_any(self) -> float:
        """Share of episodes in which the goal was reached at some step."""
        return sum(self.any) / self.episodes

    @property
    def success_end(self) -> float:
        """Share of episodes in which the goal held at the last step."""
        return sum(self.end) / self.episodes


def test_seeds(root: int, episodes: int) -> tuple[int, ...]:
    """Seeds of the test episodes: the same for every run with the same `testing.seed`, so that runs are paired."""
    tree = SeedTree(root).child("test")
    return tuple(tree.child(index).integer() for index in range(episodes))


test_seeds.__test__ = False  # type: ignore[attr-defined]  # a name of the field's, no test case


def play_episodes(
    orchestrator: Orchestrator, agent: Agent, seeds: Sequence[int], *, steps: int = 0, seconds: float = 0.0
) -> TestResult:
    """Play one episode per seed with the deterministic policy.

    Seed k is played by environment k mod size, whatever finishes first: taking the episodes that end soonest
    would favour short ones, which are the successes. Leaves no episode of the orchestrator's running.

    Raises ValueError without seeds.
    """
    count, size = len(seeds), orchestrator.size
    if not count:
        raise ValueError("a test needs at least one episode")
    reached = np.zeros(count, np.bool_)
    held = np.zeros(count, np.bool_)
    solved = np.zeros(count, np.bool_)
    returns = np.zeros(count)
    lengths = np.zeros(count, np.int64)

    playing = np.arange(min(size, count))  # the episode that each active environment plays
    environments = playing % size
    orchestrator.reset(environments, [seeds[episode] for episode in playing.tolist()])
    state = orchestrator.receive().step
    solved[playing] = reached[playing] = held[playing] = state.success
    while playing.size:
        actions = agent.act(state.observation, state.desired_goal, explore=False)
        orchestrator.step(environments, actions)
        state = orchestrator.receive().step
        returns[playing] += state.reward
        lengths[playing] += 1
        reached[playing] |= state.success
        held[playing] = state.success
        over = state.terminated | state.truncated
        if over.any():
            playing, environments, state = _next_episodes(orchestrator, seeds, playing, over, state)
            fresh = lengths[playing] == 0
            solved[playing[fresh]] = reached[playing[fresh]] = held[playing[fresh]] = state.success[fresh]
    return TestResult(
        steps=steps,
        seconds=seconds,
        any=tuple(reached.tolist()),
        end=tuple(held.tolist()),
        reset=tuple(solved.tolist()),
        returns=tuple(returns.tolist()),
        lengths=tuple(lengths.tolist()),
    )


def _next_episodes(
    orchestrator: Orchestrator, seeds: Sequence[int], playing: np.ndarray, over: np.ndarray, state: Step
) -> tuple[np.ndarray, np.ndarray, Step]:
    """Give each environment that finished its next episode; drop those that have none left."""
    size = orchestrator.size
    following = np.where(over, playing + size, playing)
    kept = following < len(seeds)
    begun = over & kept
    fields = [np.array(field) for field in state]
    if begun.any():
        orchestrator.reset(following[begun] % size, [seeds[episode] for episode in following[begun].tolist()])
        fresh = orchestrator.receive().step
        for field, new in zip(fields, fresh, strict=True):
            field[begun] = new
    following = following[kept]
    return following, following % size, Step(*(field[kept] for field in fields))
