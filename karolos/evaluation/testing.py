"""Tests: episodes on fixed seeds, without exploration and separate from training."""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from ..core import Agent, Array, Failure, Measure, Orchestrator, Received, Step
from ..core.seeding import SeedTree
from ..orchestrator.worker import isolate
from ..records.evaluation import Evaluation


@dataclass(frozen=True)
class Seeds(Sequence[int]):
    """Seeds of test episodes. A seed is computed on access: a million take 14 seconds."""

    tree: SeedTree
    places: range

    def __len__(self) -> int:
        return len(self.places)

    @overload
    def __getitem__(self, place: int) -> int: ...
    @overload
    def __getitem__(self, place: slice) -> Seeds: ...
    @override
    def __getitem__(self, place: int | slice) -> int | Seeds:
        if isinstance(place, slice):
            return Seeds(self.tree, self.places[place])
        return self.tree.child(self.places[place]).integer()


def test_seeds(root: int, episodes: int) -> Seeds:
    """Seeds of the test episodes. Runs with the same `testing.seed` have the same ones and are therefore paired."""
    return Seeds(SeedTree(root).child("test"), range(episodes))


test_seeds.__test__ = False  # type: ignore[attr-defined]  # pytest takes the name for a test case


def playing_processes(count: int, niceness: int = 0) -> ProcessPoolExecutor:
    """Processes that play policies. They ignore signals, and print on standard error.

    `niceness` lowers their priority. They are spawned, because a fork would share threads of torch.
    """
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(count, context, initializer=isolate, initargs=(niceness,))


def play_episodes(
    orchestrator: Orchestrator,
    agent: Agent,
    seeds: Sequence[int],
    *,
    steps: int = 0,
    seconds: float = 0.0,
    on_failure: Callable[[Failure], object] = lambda _: None,
    on_round: Callable[[int], object] = lambda _: None,
) -> Evaluation:
    """Play one episode per seed with the deterministic policy. No episode runs afterwards.

    Environment k mod size plays seed k. Taking the episodes that end first would favour short episodes, and these are
    successes.

    Args:
        orchestrator: the environments.
        agent: acts without exploration.
        seeds: one per episode.
        steps, seconds: of training so far, for the result.
        on_failure: is called with each failure of an environment, whose episode is then played again.
        on_round: is called with the number of completed episodes before each step of the environments. An error that
            it raises abandons the test; the orchestrator can play another one afterwards.

    Raises:
        ValueError: `seeds` is empty.
    """
    count, size = len(seeds), orchestrator.size
    if not count:
        raise ValueError("a test needs at least one episode")
    success_any, success_end, success_reset = np.zeros((3, count), np.bool_)
    returns = np.zeros(count)
    lengths = np.zeros(count, np.int64)
    distances = np.full(count, np.nan)
    rule, declared = orchestrator.signature.goal_rule, orchestrator.signature.measures
    measures = np.full((count, len(declared)), np.nan)
    latest = Step.zeros(orchestrator.signature, size)
    completed = 0
    playing = np.arange(size)
    """The episode of each environment; an environment whose episode is `count` or more has finished."""

    def begin(environments: NDArray[np.int64]) -> None:
        """Begin the episodes of these environments. If one fails, begin it again."""
        while environments.size:
            orchestrator.reset(environments, [seeds[episode] for episode in playing[environments].tolist()])
            received = orchestrator.receive()
            latest.write(received.environment, received.step)
            episodes = playing[received.environment]
            success_reset[episodes] = success_any[episodes] = success_end[episodes] = received.step.success
            returns[episodes] = lengths[episodes] = 0
            environments = after(received)

    def after(received: Received) -> NDArray[np.int64]:
        """The environments that must begin another episode: they failed, or their episode is over.

        An episode is over at its reset if its simulation diverges there.
        """
        nonlocal completed
        for failure in received.failures:
            on_failure(failure)
        over = received.environment[received.step.terminated | received.step.truncated]
        completed += over.size
        measures[playing[over]] = orchestrator.measures(over)
        playing[over] += size
        ended: NDArray[np.int64] = np.union1d(over, received.failed)
        return ended[playing[ended] < count]

    begin(np.flatnonzero(playing < count))
    while (environments := np.flatnonzero(playing < count)).size:
        on_round(completed)
        actions = agent.act(latest.observation[environments], latest.desired_goal[environments], explore=False)
        orchestrator.step(environments, actions)
        received = orchestrator.receive()
        step = received.step
        latest.write(received.environment, step)
        episodes = playing[received.environment]
        returns[episodes] += step.reward
        lengths[episodes] += 1
        success_any[episodes] |= step.success
        success_end[episodes] = step.success
        distance = None if rule is None else rule.distance(step.achieved_goal, step.desired_goal)
        if distance is not None:
            distances[episodes] = distance
        begin(after(received))
    return Evaluation.of(
        steps,
        seconds,
        any=tuple(success_any.tolist()),
        end=tuple(success_end.tolist()),
        reset=tuple(success_reset.tolist()),
        returns=tuple(returns.tolist()),
        lengths=tuple(lengths.tolist()),
        distances=None if np.isnan(distances).any() else tuple(distances.tolist()),
        has_success=orchestrator.signature.has_success or bool(success_any.any()),
        measures=measured(declared, measures),
    )


def measured(declared: Sequence[Measure], values: Array) -> dict[str, Any]:
    """Unit, better and values of each measure by name, given (episodes, measures), to six significant digits."""
    columns = [[None if math.isnan(one) else float(f"{one:.6g}") for one in column] for column in values.T.tolist()]
    return {
        one.name: {"unit": one.unit, "better": one.better, "values": tuple(column)}
        for one, column in zip(declared, columns, strict=True)
    }
