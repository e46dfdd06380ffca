"""The tests of a run that are due: plays them here, or beside training in a process of their own."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

from ..core import Agent, Failure, Orchestrator
from ..core.seeding import SeedTree
from ..errors import WorkerError
from ..evaluation.evaluation_process import DueTest, EvaluationProcess
from ..evaluation.testing import play_episodes, test_seeds
from ..records.results import TestResult
from ..spec import Spec
from ..training.assembly import make_agent
from ..training.training import Training
from .observer import Announce, RunWarnings
from .signals import StopRequest

PATIENCE = 1.0
"""Seconds of testing in the run's own process before it considers a second process."""
WORTHWHILE = 4.0
"""Seconds of testing left from which a second process is started: it needs about two seconds to start."""
MAX_PENDING = 16
"""Tests that may wait, each with a copy of the agent's state. The run's own process plays those beyond."""
MAX_LOSSES = 3
"""Test processes that may be lost until tests are played in the run's own process only."""
POLL_SECONDS = 0.1


class _AbandonedError(Exception):
    """A test that is played here breaks off; it stays pending."""


class PendingTests:
    """Plays the tests of a run in the order in which they are due.

    A test's result depends on the agent's state and on fixed seeds, not on where it is played. The first test begins
    in this process. Once tests have taken longer than PATIENCE and much testing is left, a second process plays them
    while this one trains. When training is over, both play what is left.

    Args:
        spec: of the run.
        environments: test environments of this process.
        pending: tests without a recorded result, in the order of their steps; `finished` removes tests.
        warnings: of the run.
        stop: a request abandons the test that is played here.
        announce: is called with the progress of a test.
        beside: whether a second process may be started.
    """

    def __init__(
        self,
        spec: Spec,
        environments: Orchestrator,
        pending: list[DueTest],
        warnings: RunWarnings,
        stop: StopRequest,
        announce: Announce,
        *,
        beside: bool,
    ) -> None:
        self._spec, self._environments = spec, environments
        self._warnings, self._stop, self._announce = warnings, stop, announce
        self._beside = beside
        self._seeds = test_seeds(spec.testing.seed, spec.testing.episodes)
        self.pending = pending
        self._results: dict[DueTest, TestResult] = {}
        self._here: DueTest | None = None
        """The test that this process is playing."""
        self._process: EvaluationProcess | None = None
        self._losses = 0
        self._steps = 0
        """Environment steps of training at the latest test; all of them when training is over."""
        self._agent: Agent | None = None
        self._spent = 0.0
        """Seconds of testing in this process."""
        self._played = 0
        """Episodes that were completed in this time."""
        self._seconds = 0.0
        """Of the latest test that is over."""
        self._sent = 0.0
        """When the second process got its test."""

    def add(self, training: Training) -> None:
        """Add a test of the agent as it is, and play it here unless a second process plays tests."""
        self._steps, state = training.steps, training.agent.state()
        self.pending.append(DueTest(training.steps, training.updates, training.seconds, state, self._seeds))
        while not self._stop.requested and (test := self._next()) is not None:
            if self._process is not None and len(self.pending) - len(self._results) <= MAX_PENDING:
                break
            self._play(test)
        self.advance()

    def advance(self) -> None:
        """Receive what the second process has sent, and give it the next test. Does not wait."""
        if self._process is not None:
            self._receive(self._process, 0.0)

    def finished(self) -> Iterator[tuple[DueTest, TestResult]]:
        """Remove the tests that are over from `pending`; a test waits for those before it."""
        while self.pending and self.pending[0] in self._results:
            test = self.pending.pop(0)
            yield test, self._results.pop(test)

    def play_remaining(self) -> Iterator[tuple[DueTest, TestResult]]:
        """Play all pending tests, or as many as possible until a stop is requested."""
        self._steps = self._spec.training.steps
        while self.pending and not self._stop.requested:
            test = self._next()
            if test is not None:
                self._play(test)
            elif self._process is not None:
                self._receive(self._process, POLL_SECONDS)
            yield from self.finished()

    def seconds_left(self, training: float, steps: int) -> float:
        """Estimated seconds to the end of training and tests.

        Args:
            training: seconds of training left.
            steps: environment steps left.
        """
        waiting = len(self.pending) - len(self._results)
        tests = self._seconds * (waiting + math.ceil(steps / self._spec.testing.interval))
        return training + (tests if self._process is None else max(tests - training, 0.0) / 2)

    def close(self) -> None:
        if self._process is not None:
            self._process.close()
            self._process = None

    def _next(self) -> DueTest | None:
        """The first test that nobody plays or has played."""
        busy = (self._here, self._process.test if self._process else None)
        return next((test for test in self.pending if test not in self._results and test not in busy), None)

    def _play(self, test: DueTest) -> None:
        """Play a test in this process."""
        if self._agent is None:
            self._agent = make_agent(self._spec, self._environments.signature, SeedTree(0))
        self._agent.load_state(test.agent)
        self._here, started, count = test, time.perf_counter(), len(test.seeds)
        completed = 0

        def on_round(episodes: int) -> None:
            nonlocal completed
            completed = episodes
            self._announce("testing", episodes, count)
            self.advance()
            if self._stop.requested or self._start_process(test, time.perf_counter() - started, episodes):
                raise _AbandonedError

        try:
            self._results[test] = play_episodes(
                self._environments,
                self._agent,
                test.seeds,
                steps=test.steps,
                seconds=test.seconds,
                on_failure=self._warnings.add_failure,
                on_round=on_round,
            )
            completed = count
            self._seconds = time.perf_counter() - started
            self._announce("testing", count, count)
        except _AbandonedError:
            pass
        finally:
            self._here = None
            self._spent += time.perf_counter() - started
            self._played += completed

    def _start_process(self, test: DueTest, seconds: float, episodes: int) -> bool:
        """Start the second process if it is worthwhile, given the time and the completed episodes of this test.

        Returns whether this process shall go on training and leave the test to the second one.
        """
        spent, played = self._spent + seconds, self._played + episodes
        if not self._beside or self._process is not None or spent < PATIENCE:
            return False
        settings, steps = self._spec.testing, self._spec.training.steps - self._steps
        waiting = sum(len(one.seeds) for one in self.pending if one is not test and one not in self._results)
        left = waiting + math.ceil(steps / settings.interval) * settings.episodes
        if spent / max(played, 1) * left < WORTHWHILE:
            return False
        self._process = EvaluationProcess(self._spec, self._environments.describe())
        return steps > 0

    def _receive(self, process: EvaluationProcess, timeout: float) -> None:
        test = process.test
        try:
            for message in process.receive(timeout):
                if isinstance(message, Failure):
                    self._warnings.add_failure(message)
                elif isinstance(message, TestResult):
                    if test is not None:
                        self._results[test] = message
                        self._seconds = time.perf_counter() - self._sent
                        self._announce("testing", len(test.seeds), len(test.seeds))
                elif test is not None and self._here is None:
                    self._announce("testing", message, len(test.seeds))
        except WorkerError as error:
            self._warnings.add(str(error), "its test is played again")
            self.close()
            self._losses += 1
            self._beside = self._losses < MAX_LOSSES
            return
        if process.ready and process.test is None and (test := self._next()) is not None:
            process.play(test)
            self._sent = time.perf_counter()
