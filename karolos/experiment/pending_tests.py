"""The tests of a run that are due: plays them here, or beside training in a second process."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import suppress
from time import perf_counter

from ..core import Failure
from ..evaluation.due_tests import DueTest, EvaluationProcess, Evaluator
from ..evaluation.testing import test_seeds
from ..records.results import TestResult
from ..specification import Spec
from ..training.training import Training
from .announcer import Announce
from .signals import StopRequest
from .writer import RunWriter

MEASURED_SECONDS = 1.0
"""Seconds of testing in the run's own process after which it considers a second process."""
WORTHWHILE_SECONDS = 4.0
"""Seconds of testing left from which a second process is started: it needs about two seconds to start."""
MAX_PENDING = 4
"""Tests that may wait, each with a copy of the agent's state. The run's own process plays those beyond."""
MAX_LOST_PROCESSES = 3
"""Second processes that may be lost until tests are played in the run's own process only."""


class _AbandonedError(Exception):
    """A test that is played here breaks off."""


class PendingTests:
    """Plays the tests of a run in the order in which they are due.

    Where an episode is played does not change its result. The run's own process plays tests until they are long enough
    for a second process, which then plays them while the first one trains. When training is over, both play what is
    left, long tests in parts. The last part is played by both, so that a process that hangs costs nothing.

    Args:
        spec: of the run.
        training: is tested.
        pending: tests without a recorded result, in the order of their steps; `finished` removes tests.
        writer: of the run, for warnings.
        stop: a request abandons the test that is played here.
        announce: is called with the progress of a test.
        beside: whether a second process may be started.
    """

    def __init__(
        self,
        spec: Spec,
        training: Training,
        pending: list[DueTest],
        writer: RunWriter,
        stop: StopRequest,
        announce: Announce,
        *,
        beside: bool,
    ) -> None:
        self._spec, self._training, self.pending = spec, training, pending
        self._writer, self._stop, self._announce = writer, stop, announce
        self.activity = "testing"
        """For announcements."""
        self._results: dict[DueTest, TestResult] = {}
        """Of parts of pending tests."""
        self._evaluator = Evaluator(spec)
        self._process: EvaluationProcess | None = None
        self._here: DueTest | None = None
        """What this process plays."""
        self._beside: tuple[DueTest, Future[tuple[TestResult, list[Failure]]]] | None = None
        """What the second process plays."""
        self._processes_left = MAX_LOST_PROCESSES if beside else 0
        self._played, self._spent = 0, 0.0
        """Episodes that were completed in this process, and the seconds that they took."""

    def add(self) -> None:
        """Add a test of the agent as it is, and play it here unless a second process plays tests."""
        training, testing = self._training, self._spec.testing
        seeds = test_seeds(testing.seed, testing.episodes)
        self.pending.append(DueTest(training.steps, training.updates, training.seconds, training.agent.state(), seeds))
        while not self._stop.requested and (self._process is None or len(self.pending) > MAX_PENDING):
            if (test := self._next(shared=True)) is None:
                break
            self._play(test)
        self.advance()

    def advance(self) -> None:
        """Receive what the second process has played, and give it the next test. Does not wait."""
        if self._process is None or (self._beside is not None and not self._beside[1].done()):
            return
        try:
            if self._beside is not None:
                test, future = self._beside
                result, failures = future.result()
                for failure in failures:
                    self._writer.warn_of_failure(failure)
                self._record(test, result)
                self._beside = None
            if (next_test := self._next()) is not None:
                self._beside = next_test, self._process.submit(next_test)
        except Exception as error:  # whatever it is, it must not cost the run
            self._writer.warn(f"the test process failed: {type(error).__name__}: {error}", "its test is played again")
            self._processes_left -= 1
            self._close_process()

    def finished(self) -> Iterator[tuple[DueTest, TestResult]]:
        """Remove the tests that are over from `pending`; a test waits for those before it."""
        while self.pending and all(part in self._results for part in self.pending[0].parts):
            test = self.pending.pop(0)
            yield test, TestResult.joined([self._results.pop(part) for part in test.parts])

    def play_remaining(self) -> Iterator[tuple[DueTest, TestResult]]:
        """Play all pending tests, or as many as possible until a stop is requested."""
        while not self._stop.requested and (test := self._next(shared=True)) is not None:
            self._play(test)
            yield from self.finished()

    def close(self) -> None:
        self._close_process()
        self._evaluator.close()

    def _close_process(self) -> None:
        if self._process is not None:
            self._process.close(kill=self._beside is not None)
            self._process = None
        self._beside = None

    def _parts(self) -> list[DueTest]:
        """Of all pending tests."""
        return [part for test in self.pending for part in test.parts]

    def _next(self, *, shared: bool = False) -> DueTest | None:
        """The first part that no process plays or has played; with `shared`, otherwise that of the second process."""
        unfinished = [part for part in self._parts() if part not in self._results]
        taken = (self._here, self._beside and self._beside[0])
        free = [test for test in unfinished if test not in taken]
        return next(iter(free or (unfinished if shared else ())), None)

    def _episodes_left(self, steps: int) -> int:
        """Episodes of the pending tests, of those that the environment steps left make due, and of the final test."""
        waiting = sum(len(part.seeds) for part in self._parts() if part not in self._results)
        testing = self._spec.testing
        final = testing.final_count if self.activity == "testing" else 0
        return waiting + math.ceil(steps / testing.interval) * testing.episodes + final

    def _play(self, test: DueTest) -> None:
        """Play a test, or a part of it, in this process.

        Breaks off at a stop, when the second process shall play it, and when the second process has played it.
        """
        started, spent, played = perf_counter(), self._spent, self._played
        self._here = test

        def on_round(completed: int) -> None:
            self._tell(completed)
            self._spent, self._played = spent + perf_counter() - started, played + completed
            self.advance()
            left_to_process = self._starts_process() and self._training.steps < self._spec.training.steps
            if test in self._results or self._stop.requested or left_to_process:
                raise _AbandonedError

        with suppress(_AbandonedError):
            self._record(test, self._evaluator.play(test, self._writer.warn_of_failure, on_round))
            self._spent, self._played = spent + perf_counter() - started, played + len(test.seeds)
        self._here = None

    def _record(self, test: DueTest, result: TestResult) -> None:
        """Keep the first result of a test or a part."""
        if test in self._parts():
            self._results.setdefault(test, result)
        self._tell()

    def _tell(self, playing: int = 0) -> None:
        """Announce the episodes of pending tests that are over; `playing`: of these, those of the part played here."""
        done = playing + sum(result.episodes for result in self._results.values())
        self._announce(self.activity, done, sum(len(test.seeds) for test in self.pending))

    def _starts_process(self) -> bool:
        """Start the second process if the tests played here say that it is worthwhile. Returns whether it starts."""
        if self._process is not None or not self._processes_left or self._spent < MEASURED_SECONDS:
            return False
        left = self._episodes_left(self._spec.training.steps - self._training.steps)
        if self._spent / max(self._played, 1) * left < WORTHWHILE_SECONDS:
            return False
        self._process = EvaluationProcess(self._spec)
        return True
