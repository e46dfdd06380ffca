"""The tests of a run that are due: plays them here, or beside training in a second process."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace
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
PART_EPISODES = 24
"""Fewest episodes of a part of a test, which one process plays."""
MAX_PENDING = 16
"""Tests that may wait, each with a copy of the agent's state. The run's own process plays those beyond."""
MAX_LOST_PROCESSES = 3
"""Second processes that may be lost until tests are played in the run's own process only."""


class _AbandonedError(Exception):
    """A part that is played here breaks off."""


@dataclass(eq=False)
class _Part:
    """Some episodes of a test, which one process plays."""

    test: DueTest
    """With the seeds of these episodes only."""
    taken: bool = False
    """Whether a process plays it or has played it."""
    completed: int = 0
    """Episodes."""
    result: TestResult | None = None


class PendingTests:
    """Plays the tests of a run in the order in which they are due.

    Where an episode is played does not change its result. The run's own process plays tests until they are long enough
    for a second process, which then plays them while the first one trains. When training is over, both play what is
    left, in parts of some episodes. The last part is played by both, so that a process that hangs costs nothing.

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
        self._parts: dict[DueTest, list[_Part]] = {}
        self._evaluator = Evaluator(spec)
        self._process: EvaluationProcess | None = None
        self._beside: tuple[_Part, Future[tuple[TestResult, list[Failure]]]] | None = None
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
            if (part := self._next(shared=True)) is None:
                break
            self._play(part)
        self.advance()

    def advance(self) -> None:
        """Receive what the second process has played, and give it the next part. Does not wait."""
        if self._process is None or (self._beside is not None and not self._beside[1].done()):
            return
        try:
            if self._beside is not None:
                part, future = self._beside
                result, failures = future.result()
                for failure in failures:
                    self._writer.warn_of_failure(failure)
                if part.result is None:
                    self._record(part, result)
                self._beside = None
            if (next_part := self._next()) is not None:
                self._beside = next_part, self._process.submit(next_part.test)
                next_part.taken = True
        except Exception as error:  # whatever it is, it must not cost the run
            self._writer.warn(f"the test process failed: {type(error).__name__}: {error}", "its test is played again")
            self._processes_left -= 1
            self._close_process()

    def finished(self) -> Iterator[tuple[DueTest, TestResult]]:
        """Remove the tests that are over from `pending`; a test waits for those before it."""
        while self.pending:
            parts = self._parts_of(self.pending[0])
            results = [part.result for part in parts if part.result is not None]
            if len(results) < len(parts):
                return
            test = self.pending.pop(0)
            del self._parts[test]
            yield test, TestResult.joined(results)

    def play_remaining(self) -> Iterator[tuple[DueTest, TestResult]]:
        """Play all pending tests, or as many as possible until a stop is requested."""
        while not self._stop.requested and (part := self._next(shared=True)) is not None:
            self._play(part)
            yield from self.finished()

    def seconds_left(self, training: float, steps: int) -> float:
        """Estimated seconds to the end of training and tests.

        Args:
            training: seconds of training left.
            steps: environment steps left.
        """
        tests = self._spent / max(self._played, 1) * self._episodes_left(steps)
        return training + (tests if self._process is None else max(tests - training, 0.0) / 2)

    def close(self) -> None:
        self._close_process()
        self._evaluator.close()

    def _close_process(self) -> None:
        if self._process is not None:
            self._process.close(kill=self._beside is not None)
            self._process = None
        if self._beside is not None:
            self._beside[0].taken = self._beside[0].result is not None
            self._beside = None

    def _parts_of(self, test: DueTest) -> list[_Part]:
        if test not in self._parts:
            environments = self._training.orchestrator.size
            size = environments * math.ceil(PART_EPISODES / environments)  # all of them are busy until its end
            starts = range(0, len(test.seeds), size)
            self._parts[test] = [_Part(replace(test, seeds=test.seeds[at : at + size])) for at in starts]
        return self._parts[test]

    def _next(self, *, shared: bool = False) -> _Part | None:
        """The first part that no process plays or has played; with `shared`, otherwise that of the second process."""
        unfinished = [part for test in self.pending for part in self._parts_of(test) if part.result is None]
        return next((part for part in unfinished if not part.taken), unfinished[0] if unfinished and shared else None)

    def _episodes_left(self, steps: int) -> int:
        """Episodes of the pending tests, of those that the environment steps left make due, and of the final test."""
        parts = (part for test in self.pending for part in self._parts_of(test))
        waiting = sum(len(part.test.seeds) for part in parts if part.result is None)
        testing = self._spec.testing
        final = testing.final_count if self.activity == "testing" else 0
        return waiting + math.ceil(steps / testing.interval) * testing.episodes + final

    def _play(self, part: _Part) -> None:
        """Play a part in this process.

        Breaks off at a stop, when the second process shall play it, and when the second process has played it.
        """
        started, spent, played = perf_counter(), self._spent, self._played
        taken, part.taken = part.taken, True

        def on_round(completed: int) -> None:
            self._record(part, completed)
            self._spent, self._played = spent + perf_counter() - started, played + completed
            self.advance()
            left_to_process = self._starts_process() and self._training.steps < self._spec.training.steps
            if part.result is not None or self._stop.requested or left_to_process:
                raise _AbandonedError

        try:
            result = self._evaluator.play(part.test, self._writer.warn_of_failure, on_round)
        except _AbandonedError:
            part.taken = taken or part.result is not None
        else:
            self._record(part, result)
            self._spent, self._played = spent + perf_counter() - started, played + result.episodes

    def _record(self, part: _Part, news: int | TestResult) -> None:
        """Record the completed episodes or the result of a part, and announce how far its test is."""
        if isinstance(news, TestResult):
            part.result = news
        part.completed = news.episodes if isinstance(news, TestResult) else news
        parts = next(parts for parts in self._parts.values() if part in parts)
        done, total = sum(one.completed for one in parts), sum(len(one.test.seeds) for one in parts)
        self._announce(self.activity, done, total)

    def _starts_process(self) -> bool:
        """Start the second process if the tests played here say that it is worthwhile. Returns whether it starts."""
        if self._process is not None or not self._processes_left or self._spent < MEASURED_SECONDS:
            return False
        left = self._episodes_left(self._spec.training.steps - self._training.steps)
        if self._spent / max(self._played, 1) * left < WORTHWHILE_SECONDS:
            return False
        self._process = EvaluationProcess(self._spec)
        return True
