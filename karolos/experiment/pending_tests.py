"""The tests of a run that are due: plays them here, or beside training in a process of their own."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

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
MANY_STEPS = 100_000
"""Test steps left for which a second process is started at once. The fastest environments take 4 s for them."""
MEASURED_ROUNDS = 20
"""Rounds of warm-up from which the time per environment step is estimated."""
PART_EPISODES = 24
"""Fewest episodes of a part of a test, which one process plays."""
MAX_PENDING = 16
"""Tests that may wait, each with a copy of the agent's state. The run's own process plays those beyond."""
MAX_LOSSES = 3
"""Test processes that may be lost until tests are played in the run's own process only."""
POLL_SECONDS = 0.1


class _AbandonedError(Exception):
    """A part that is played here breaks off; it stays pending."""


class PendingTests:
    """Plays the tests of a run in the order in which they are due.

    The result of an episode depends on the agent's state and on its seed, not on where it is played. A second process
    plays tests while this one trains, if they take long. Their number says so, or the time that warm-up needs per step,
    or else the first tests, which this process begins. When training is over, both play what is left, in parts of some
    episodes.

    Args:
        spec: of the run.
        training: is tested.
        make_environments: makes the test environments of this process, when it plays its first test.
        pending: tests without a recorded result, in the order of their steps; `finished` removes tests.
        warnings: of the run.
        stop: a request abandons the test that is played here.
        announce: is called with the progress of a test.
        beside: whether a second process may be started.
    """

    def __init__(  # noqa: PLR0917  (all are needed, by one caller)
        self,
        spec: Spec,
        training: Training,
        make_environments: Callable[[], Orchestrator],
        pending: list[DueTest],
        warnings: RunWarnings,
        stop: StopRequest,
        announce: Announce,
        *,
        beside: bool,
    ) -> None:
        self._spec, self._training, self._make_environments = spec, training, make_environments
        self._warnings, self._stop, self._announce = warnings, stop, announce
        self._beside = beside
        self._seeds = test_seeds(spec.testing.seed, spec.testing.episodes)
        size = training.orchestrator.size
        self._part_size = size * math.ceil(PART_EPISODES / size)
        """A multiple of the environments, so that they are busy until the end of a part."""
        self.pending = pending
        self._parts: dict[DueTest, list[DueTest]] = {}
        """The parts of pending tests."""
        self._results: dict[DueTest, TestResult] = {}
        """Of parts."""
        self._completed: dict[DueTest, int] = {}
        """Completed episodes of parts."""
        self._here: DueTest | None = None
        """The part that this process is playing."""
        self._process: EvaluationProcess | None = None
        self._losses = 0
        self._environments: Orchestrator | None = None
        self._agent: Agent | None = None
        self._loaded: DueTest | None = None
        """The latest part whose agent was loaded."""
        self._warmed_up: tuple[int, float] | None = None
        """Steps and seconds of training after the first round of warm-up; None: before it, or the run was resumed."""
        self._spent = 0.0
        """Seconds of testing in this process."""
        self._played = 0
        """Episodes that were completed in this time."""
        self._seconds = 0.0
        """Per episode of the latest part."""
        self._sent = 0.0
        """When the second process got its part."""
        self.activity = "testing"
        """For announcements."""

    def add(self) -> None:
        """Add a test of the agent as it is, and play it here unless a second process plays tests."""
        training, state = self._training, self._training.agent.state()
        self.pending.append(DueTest(training.steps, training.updates, training.seconds, state, self._seeds))
        while not self._stop.requested and (part := self._next()) is not None:
            if self._process is not None and len(self.pending) <= MAX_PENDING:
                break
            self._play(part)
        self.advance()

    def advance(self) -> None:
        """Receive what the second process has sent, and give it the next part. Does not wait."""
        if self._process is not None:
            self._receive(self._process, 0.0)
        elif self._beside:
            self._expect()

    def finished(self) -> Iterator[tuple[DueTest, TestResult]]:
        """Remove the tests that are over from `pending`; a test waits for those before it."""
        while self.pending and all(part in self._results for part in self._parts_of(self.pending[0])):
            test = self.pending.pop(0)
            parts = self._parts.pop(test)
            for part in parts:
                self._completed.pop(part, None)
            yield test, TestResult.joined([self._results.pop(part) for part in parts])

    def play_remaining(self) -> Iterator[tuple[DueTest, TestResult]]:
        """Play all pending tests, or as many as possible until a stop is requested."""
        while self.pending and not self._stop.requested:
            part = self._next()
            if part is not None:
                self._play(part)
            elif self._process is not None:
                self._receive(self._process, POLL_SECONDS)
            yield from self.finished()

    def seconds_left(self, training: float, steps: int) -> float:
        """Estimated seconds to the end of training and tests.

        Args:
            training: seconds of training left.
            steps: environment steps left.
        """
        tests = self._seconds * self._episodes_left(steps)
        return training + (tests if self._process is None else max(tests - training, 0.0) / 2)

    def close(self) -> None:
        if self._process is not None:
            self._process.close()
            self._process = None
        if self._environments is not None:
            self._environments.close()
            self._environments = None

    def _parts_of(self, test: DueTest) -> list[DueTest]:
        if test not in self._parts:
            starts = range(0, len(test.seeds), self._part_size)
            self._parts[test] = [replace(test, seeds=test.seeds[at : at + self._part_size]) for at in starts]
        return self._parts[test]

    def _next(self) -> DueTest | None:
        """The first part that nobody plays or has played."""
        busy = (self._here, self._process.test if self._process else None)
        parts = (part for test in self.pending for part in self._parts_of(test))
        return next((part for part in parts if part not in self._results and part not in busy), None)

    def _episodes_left(self, steps: int) -> int:
        """Episodes of the pending tests, of those that the environment steps left make due, and of the final test."""
        waiting = sum(
            len(part.seeds) for test in self.pending for part in self._parts_of(test) if part not in self._results
        )
        testing = self._spec.testing
        final = testing.final_count if self.activity == "testing" else 0
        return waiting + math.ceil(steps / testing.interval) * testing.episodes + final

    def _play(self, part: DueTest) -> None:
        """Play a part in this process."""
        if self._environments is None:
            self._environments = self._make_environments()
        if self._agent is None:
            self._agent = make_agent(self._spec, self._environments.signature, SeedTree(0))
        if self._loaded is None or self._loaded.agent is not part.agent:
            self._agent.load_state(part.agent)
            self._loaded = part
        self._here, started = part, time.perf_counter()

        def on_round(episodes: int) -> None:
            self._tell(part, episodes)
            self.advance()
            if self._stop.requested or self._leave_to_process(time.perf_counter() - started, episodes):
                raise _AbandonedError

        try:
            self._results[part] = play_episodes(
                self._environments,
                self._agent,
                part.seeds,
                steps=part.steps,
                seconds=part.seconds,
                on_failure=self._warnings.add_failure,
                on_round=on_round,
            )
            self._tell(part, len(part.seeds))
            self._seconds = (time.perf_counter() - started) / len(part.seeds)
        except _AbandonedError:
            pass
        finally:
            self._here = None
            self._spent += time.perf_counter() - started
            self._played += self._completed.get(part, 0)

    def _tell(self, part: DueTest, completed: int) -> None:
        """Announce the completed episodes of the test to which a part belongs."""
        self._completed[part] = completed
        test = next(test for test, parts in self._parts.items() if part in parts)
        done = sum(self._completed.get(part, 0) for part in self._parts[test])
        self._announce(self.activity, done, len(test.seeds))

    def _expect(self) -> None:
        """Start the second process before the first test if test steps are many, or slow in warm-up."""
        training, max_steps = self._training, self._training.orchestrator.signature.max_steps
        self._start_process(WORTHWHILE / MANY_STEPS * max_steps)
        if self._process is None and training.collector.warming_up:
            if self._warmed_up is None:
                self._warmed_up = training.steps, training.seconds
            steps, seconds = self._warmed_up
            if training.steps - steps >= training.orchestrator.size * MEASURED_ROUNDS:
                self._start_process((training.seconds - seconds) / (training.steps - steps) * max_steps)

    def _leave_to_process(self, seconds: float, episodes: int) -> bool:
        """Start the second process if the tests played here so far say that it is worthwhile.

        Args:
            seconds: spent on the part that is played here.
            episodes: of it that are completed.

        Returns:
            Whether this process shall go on training and leave the part to the second one.
        """
        spent, played = self._spent + seconds, self._played + episodes
        if self._process is not None or spent < PATIENCE:
            return False
        return self._start_process(spent / max(played, 1)) and self._training.steps < self._spec.training.steps

    def _start_process(self, seconds: float) -> bool:
        """Start the second process if it is worthwhile for tests with this number of seconds per episode."""
        steps = self._spec.training.steps - self._training.steps
        if not self._beside or seconds * self._episodes_left(steps) < WORTHWHILE:
            return False
        self._process = EvaluationProcess(self._spec, self._training.orchestrator.describe())
        return True

    def _receive(self, process: EvaluationProcess, timeout: float) -> None:
        part = process.test
        try:
            for message in process.receive(timeout):
                if isinstance(message, Failure):
                    self._warnings.add_failure(message)
                elif isinstance(message, TestResult):
                    if part is not None:
                        self._results[part] = message
                        self._seconds = (time.perf_counter() - self._sent) / len(part.seeds)
                        self._tell(part, len(part.seeds))
                elif part is not None:
                    self._tell(part, message)
        except WorkerError as error:
            self._warnings.add(str(error), "its test is played again")
            self._process = None
            process.close()
            self._losses += 1
            self._beside = self._losses < MAX_LOSSES
            return
        if process.ready and process.test is None and (test := self._next()) is not None:
            process.play(test)
            self._sent = time.perf_counter()
