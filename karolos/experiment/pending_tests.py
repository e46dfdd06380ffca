"""Plays the tests of a run that are due: in this process, or in a second one during training."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import suppress
from time import perf_counter

from ..core import Failure
from ..evaluation.due_tests import DueEvaluation, EvaluationProcess, Evaluator
from ..evaluation.testing import test_seeds
from ..records.evaluation import Evaluation
from ..specification import Spec
from ..training.training import Training
from .signals import StopRequest, StopRequestedError
from .writer import RunWriter

MEASURED_SECONDS = 1.0
"""Seconds of testing in the run's own process after which it considers a second process."""
WORTHWHILE_SECONDS = 4.0
"""A second process is started if at least this many seconds of testing are left. Its start takes about two seconds."""
MAX_WAITING = 1
"""Number of tests that may wait for the second process during training. Training waits for earlier tests."""
MAX_LOST_PROCESSES = 3
"""Number of lost second processes after which the run's own process plays all tests."""


class PendingTests:
    """Plays the tests of a run in the order in which they are due.

    A test consists of parts. The process that plays a part does not change its result.

    * The first test is played when it is due, and training waits for it: a person waits for its result.
    * The run's own process plays tests until they are long enough for a second process, which is then started.
    * From then on training goes on during a test. When the next test is due, training waits until the test before is
      over: on a busy machine the second process may hardly run.
    * After training both processes play the remaining tests.

    A process without a part of its own also plays the part of the other process, and the first result counts. A second
    process that hangs therefore costs no more time than it would have saved.

    `pending` holds the tests without a recorded result, in the order of their steps; `finished` removes tests. A stop
    request aborts the part that is played here, and the tests stay pending.
    """

    def __init__(
        self,
        spec: Spec,
        training: Training,
        pending: list[DueEvaluation],
        writer: RunWriter,
        stop: StopRequest,
        *,
        two_processes: bool,
    ) -> None:
        self._spec, self._training, self.pending = spec, training, pending
        self._writer, self._stop = writer, stop
        self.activity = "testing"
        """Word for announcements."""
        self._any_finished = False
        """Whether this process has seen a result."""
        self._told = 0
        """Episodes of finished tests that announcements count, until no test is pending."""
        self._results: dict[DueEvaluation, Evaluation] = {}
        """The results of parts of pending tests."""
        self._evaluator = Evaluator(spec)
        self._here: DueEvaluation | None = None
        """The part that this process plays."""
        self._process: EvaluationProcess | None = None
        self._there: tuple[DueEvaluation, Future[tuple[Evaluation, list[Failure]]]] | None = None
        """The part that the second process plays, and its result."""
        self._processes_left = MAX_LOST_PROCESSES if two_processes else 0
        self._played, self._spent = 0, 0.0
        """Episodes that were completed in this process, and the seconds that they took."""

    def add(self) -> None:
        """Add a test of the current agent, and play the tests that may not wait."""
        training, testing = self._training, self._spec.testing
        seeds = test_seeds(testing.seed, testing.episodes)
        self.pending.append(
            DueEvaluation(training.steps, training.updates, training.seconds, training.agent.state(), seeds)
        )
        self.catch_up()

    def catch_up(self) -> None:
        """Play tests here until only the number that may wait during training is left."""
        while not self._stop.requested:
            most = MAX_WAITING if self._process is not None and self._any_finished else 0
            if self._waiting() <= most:
                break
            self._play_here()
        self.advance()

    def play_remaining(self) -> Iterator[tuple[DueEvaluation, Evaluation]]:
        """Play all pending tests, or as many as possible until a stop is requested."""
        yield from self.finished()
        while not self._stop.requested and self.pending:
            self._play_here()
            yield from self.finished()

    def finished(self) -> Iterator[tuple[DueEvaluation, Evaluation]]:
        """Remove finished tests from `pending`, in order: a test waits for the tests before it."""
        while self.pending and self._is_over(self.pending[0]):
            self._any_finished = True
            test = self.pending.pop(0)
            self._told = self._told + len(test.seeds) if self.pending else 0
            yield test, Evaluation.joined([self._results.pop(part) for part in test.parts])

    def _play_here(self) -> None:
        """Play the next part in this process. Aborts at a stop, or if the second process was faster."""
        part = self._here = next(self._parts(taken=False), None) or next(self._parts())
        started, spent, played = perf_counter(), self._spent, self._played

        def on_round(completed: int) -> None:
            self._tell(completed)
            # The duration of tests decides whether a second process is started.
            self._spent, self._played = spent + perf_counter() - started, played + completed
            if self._is_process_worthwhile():
                self._process = EvaluationProcess(self._spec)
            # The second process may wait for another part, or may have played this one.
            self.advance()
            if part in self._results or self._stop.requested:
                raise StopRequestedError

        with suppress(StopRequestedError):
            with self._stop.at_once():
                self._evaluator.prepare()
            self._record(part, self._evaluator.play(part, self._writer.warn_of_failure, on_round))
            self._spent, self._played = spent + perf_counter() - started, played + len(part.seeds)
        self._here = None

    def _is_process_worthwhile(self) -> bool:
        """Whether a second process would save more time than its start takes, by the tests played here."""
        if self._process is not None or not self._processes_left or self._spent < MEASURED_SECONDS:
            return False
        testing, steps = self._spec.testing, self._spec.training.steps - self._training.steps
        episodes = sum(len(part.seeds) for part in self._parts())
        episodes += math.ceil(steps / testing.interval) * testing.episodes
        episodes += testing.final_count if self.activity == "testing" else 0
        return self._spent / max(self._played, 1) * episodes >= WORTHWHILE_SECONDS

    def advance(self) -> None:
        """Receive what the second process has played, and give it the next part. Does not wait."""
        if self._process is None or (self._there is not None and not self._there[1].done()):
            return
        try:
            if self._there is not None:
                part, future = self._there
                result, failures = future.result()
                for failure in failures:
                    self._writer.warn_of_failure(failure)
                self._record(part, result)
                self._there = None
            if (free := next(self._parts(taken=False), None)) is not None:
                self._there = free, self._process.submit(free)
        except Exception as error:  # no error here may end the run
            self._writer.warn(f"the test process failed: {type(error).__name__}: {error}", "its test is played again")
            self._processes_left -= 1
            self._close_process()

    def _record(self, part: DueEvaluation, result: Evaluation) -> None:
        """Keep the first result of a part."""
        if part in self._parts():
            self._results[part] = result
        self._tell()

    def _tell(self, playing: int = 0) -> None:
        """Announce the finished episodes of pending tests; `playing`: those of the part that is played here."""
        done = self._told + playing + sum(result.episodes for result in self._results.values())
        self._writer.announce(self.activity, done, self._told + sum(len(test.seeds) for test in self.pending))

    def _parts(self, *, taken: bool = True) -> Iterator[DueEvaluation]:
        """The parts without a result, in order; `taken`: also those that a process plays."""
        playing = () if taken else (self._here, self._there and self._there[0])
        every = (part for test in self.pending for part in test.parts)
        return (part for part in every if part not in self._results and part not in playing)

    def _waiting(self) -> int:
        """Pending tests that are not over."""
        return sum(not self._is_over(test) for test in self.pending)

    def _is_over(self, test: DueEvaluation) -> bool:
        return all(part in self._results for part in test.parts)

    def close(self) -> None:
        self._close_process()
        self._evaluator.close()

    def _close_process(self) -> None:
        if self._process is not None:
            self._process.close(kill=self._there is not None)
            self._process = None
        self._there = None
