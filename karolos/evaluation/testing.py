"""Tests: episodes without exploration on fixed seeds, apart from training, counted honestly."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..core import Agent, Failure, Orchestrator, Received
from ..core.seeding import SeedTree
from ..records.results import TestResult
from ..training.episodes import empty_steps, write_rows


def test_seeds(root: int, episodes: int) -> tuple[int, ...]:
    """Seeds of the test episodes: the same for every run with the same `testing.seed`, so that runs are paired."""
    tree = SeedTree(root).child("test")
    return tuple(tree.child(index).integer() for index in range(episodes))


test_seeds.__test__ = False  # type: ignore[attr-defined]  # a name of the field's, no test case


def play_episodes(
    orchestrator: Orchestrator,
    agent: Agent,
    seeds: Sequence[int],
    *,
    steps: int = 0,
    seconds: float = 0.0,
    on_failure: Callable[[Failure], object] | None = None,
) -> TestResult:
    """Play one episode per seed with the deterministic policy.

    Seed k is played by environment k mod size, whatever finishes first: taking the episodes that end soonest
    would favour short ones, which are the successes. Leaves no episode of the orchestrator's running. An episode whose
    environment fails is played again from its beginning, and `on_failure` hears of it.

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
    distances = np.full(count, np.nan)
    rule = orchestrator.signature.goal_rule
    latest = empty_steps(orchestrator)
    playing = np.arange(size)  # the episode that each environment plays; none from `count` on

    def begin(environments: NDArray[np.int64]) -> None:
        """Begin the episodes that these environments are to play, and again those that fail meanwhile."""
        while environments.size:
            orchestrator.reset(environments, [seeds[episode] for episode in playing[environments].tolist()])
            received = orchestrator.receive()
            write_rows(latest, received.environment, received.step)
            episodes = playing[received.environment]
            solved[episodes] = reached[episodes] = held[episodes] = received.step.success
            returns[episodes] = lengths[episodes] = 0
            environments = lost(received)

    def lost(received: Received) -> NDArray[np.int64]:
        """The environments that failed and have an episode to play."""
        if on_failure:
            for failure in received.failures:
                on_failure(failure)
        return received.failed[playing[received.failed] < count]

    begin(np.flatnonzero(playing < count))
    while (environments := np.flatnonzero(playing < count)).size:
        actions = agent.act(latest.observation[environments], latest.desired_goal[environments], explore=False)
        orchestrator.step(environments, actions)
        received = orchestrator.receive()
        state = received.step
        write_rows(latest, received.environment, state)
        episodes = playing[received.environment]
        returns[episodes] += state.reward
        lengths[episodes] += 1
        reached[episodes] |= state.success
        held[episodes] = state.success
        far = None if rule is None else rule.distance(state.achieved_goal, state.desired_goal)
        if far is not None:
            distances[episodes] = far
        over = received.environment[state.terminated | state.truncated]
        playing[over] += size
        begin(np.sort(np.concatenate((over[playing[over] < count], lost(received)))))
    return TestResult(
        steps=steps,
        seconds=seconds,
        any=tuple(reached.tolist()),
        end=tuple(held.tolist()),
        reset=tuple(solved.tolist()),
        returns=tuple(returns.tolist()),
        lengths=tuple(lengths.tolist()),
        distances=None if np.isnan(distances).any() else tuple(distances.tolist()),
    )
