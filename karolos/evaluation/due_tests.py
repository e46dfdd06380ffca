"""Tests of an agent as it was at some step. They run in this process, or in a second one during training.

A test depends only on the agent's state and on fixed seeds. Its result is the same in every process.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import cache, cached_property
from multiprocessing.util import Finalize

from ..core import Agent, Failure, Orchestrator, State
from ..core.seeding import SeedTree
from ..orchestrator.processes import fresh_start
from ..records import checkpoint
from ..records.evaluation import Evaluation
from ..specification import Spec, spec_from_dict
from ..training.assembly import make_agent, make_orchestrator, use_threads
from .testing import play_episodes, playing_processes

NICENESS = 10
"""Added to the priority value of the second process. On a busy core it gets about a tenth of the time."""
PART = 50
"""Largest number of episodes in a part of a test. Two processes share the parts of longer tests."""
CLOSE_SECONDS = 3.0
"""Seconds after which an idle process that does not end is killed."""


@dataclass(frozen=True, eq=False)
class DueEvaluation:
    """A test that is due: the agent's state, and the progress of training at that time."""

    steps: int
    updates: int
    seconds: float
    """Wall-clock seconds of collecting and learning."""
    agent: State
    seeds: Sequence[int]
    """One per episode."""

    @cached_property
    def parts(self) -> tuple[DueEvaluation, ...]:
        """The test in parts of PART episodes, or as it is if it is shorter."""
        if len(self.seeds) <= PART:
            return (self,)
        return tuple(replace(self, seeds=self.seeds[first : first + PART]) for first in range(0, len(self.seeds), PART))


class Evaluator:
    """Plays tests of a spec's agents. Makes its environments and its agent at the first test."""

    def __init__(self, spec: Spec) -> None:
        self._spec = spec
        self._environments: Orchestrator | None = None
        self._agent: Agent | None = None

    def play(
        self,
        test: DueEvaluation,
        on_failure: Callable[[Failure], object],
        on_round: Callable[[int], object] = lambda _: None,
    ) -> Evaluation:
        """Play a test; `on_failure` and `on_round` as for `play_episodes`."""
        environments, agent = self.prepare()
        agent.load_state(test.agent)
        return play_episodes(
            environments,
            agent,
            test.seeds,
            steps=test.steps,
            seconds=test.seconds,
            on_failure=on_failure,
            on_round=on_round,
        )

    def prepare(self) -> tuple[Orchestrator, Agent]:
        """The environments and the agent, which are made once."""
        if self._environments is None:
            self._environments = make_orchestrator(self._spec, randomize=False)
        if self._agent is None:
            self._agent = make_agent(self._spec, self._environments.signature, SeedTree(0))
        return self._environments, self._agent

    def close(self) -> None:
        """End the environments. Safe to call twice."""
        if self._environments is not None:
            self._environments.close()
            self._environments = None


class EvaluationProcess:
    """A second process, of low priority, that plays one test at a time."""

    def __init__(self, spec: Spec) -> None:
        self._spec = json.dumps(spec.dump())
        self._pool = playing_processes(1, NICENESS)

    def submit(self, test: DueEvaluation) -> Future[tuple[Evaluation, list[Failure]]]:
        """Begin a test; its result comes with the failures of environments.

        Raises:
            OSError, BrokenProcessPool: the machine cannot start the process, or it has ended.
        """
        with fresh_start():  # the first one starts the process
            return self._pool.submit(_play, self._spec, checkpoint.pack_state(test.agent), replace(test, agent={}))

    def close(self, *, kill: bool) -> None:
        """End the process. `kill`: also while it plays."""
        processes = list((self._pool._processes or {}).values())  # Python 3.14 has `kill_workers`
        self._pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            if not kill:
                process.join(CLOSE_SECONDS)
            process.kill()
            process.join()


def _play(resolved: str, agent: bytes, test: DueEvaluation) -> tuple[Evaluation, list[Failure]]:
    failures: list[Failure] = []
    result = _evaluator(resolved).play(replace(test, agent=checkpoint.unpack_state(agent)), failures.append)
    return result, failures


@cache
def _evaluator(resolved: str) -> Evaluator:
    spec = spec_from_dict(json.loads(resolved))
    use_threads(spec)
    part = spec.orchestrator
    if part.name == "local" and max(part.settings.processes, 1) * part.settings.threads == 1:
        # This process steps environments itself instead of waiting for a worker.
        spec = spec.having("orchestrator", processes=0)
    evaluator = Evaluator(spec)
    Finalize(None, evaluator.close, exitpriority=1)  # before the process waits for the environments' workers
    return evaluator
