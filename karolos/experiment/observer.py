"""The interface of the observers of a run, which write down what happens or tell a listener."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

from typing_extensions import override

from ..core import Failure
from ..errors import KarolosError
from ..evaluation.due_tests import DueTest
from ..records import RunFolder
from ..records.final_test import FinalTest
from ..records.results import TestResult
from ..records.run_records import State
from ..training.episodes import Episode
from ..training.training import Progress, Training
from .events import Listener, RunAdvanced, RunBusy, RunEnded, RunFinalTested, RunTested, RunWarned

ADVANCE_SECONDS = 0.1
"""Minimal time between two RunAdvanced or two RunBusy events."""
SPEED_WINDOW = 100
"""RunAdvanced events from which the time left is estimated: about ten seconds."""

Announce = Callable[[str, int, int], None]
"""Is called with an activity, and how much of it is done, of how much."""


@dataclass(frozen=True)
class Ending:
    """How a run ended."""

    state: State
    """finished, stopped or failed."""
    steps: int | None = None
    """Environment steps of training; None if training broke off."""
    seconds: float | None = None
    """Wall-clock seconds of collecting and learning; None if training broke off."""
    updates: int | None = None
    """Gradient updates; None if training broke off."""
    reason: str | None = None
    """Why it stopped."""
    error: str | None = None
    """Why it failed."""
    traceback: str | None = None
    """Of the error, if karolos or a plugin is at fault."""


class RunObserver:
    """Observes one run. `Run` calls the methods of all its observers in the order of its list.

    The calls are `started`; then `progressed` after each round, `reported` several times between two tests and
    `tested` after each test; then `trained`; then `final_tested`, if training is complete and the spec has a
    final test; then `ended`. A run that breaks off skips to `ended`. An observer
    overrides the methods it needs.

    An error that an observer raises fails the run. An observer that the run can do without tolerates its own errors
    (`RunWarnings.tolerated`).
    """

    def started(self) -> None:
        """The run starts or resumes. Nothing is built yet."""

    def progressed(self, progress: Progress) -> None:
        """A round of training is over."""

    def reported(self, training: Training, episodes: Sequence[Episode], metrics: Mapping[str, float]) -> None:
        """A part of training is over.

        Args:
            training: at this step.
            episodes: that ended since the last report.
            metrics: means of what the agent reported since the last report; finite.
        """

    def tested(self, training: Training, test: DueTest, result: TestResult) -> None:
        """A test is over. Training may have gone on since it was due."""

    def trained(self, training: Training) -> None:
        """Training is complete, or stops on request."""

    def final_tested(self, final: FinalTest) -> None:
        """The final test is over."""

    def ended(self, ending: Ending) -> None:
        """The run is over. Environments are closed."""


@dataclass(frozen=True)
class RunWarnings:
    """Writes problems that a run survives into its folder, and tells the listener."""

    folder: RunFolder
    listener: Listener

    def add(self, warning: str, consequence: str) -> None:
        self.folder.event("warning", error=warning, consequence=consequence)
        self.listener(RunWarned(self.folder.id, f"{warning} ({consequence})"))

    def add_failure(self, failure: Failure) -> None:
        """Environments failed and begin their episodes again."""
        environments = ", ".join(map(str, failure.environment.tolist()))
        self.add(str(failure.error), f"the episodes of these environments begin again: {environments}")

    @contextmanager
    def tolerated(self, kind: type[KarolosError], consequence: str) -> Iterator[None]:
        """Turn an error of this kind into a warning."""
        try:
            yield
        except kind as error:
            self.add(str(error), consequence)


@dataclass
class Announcer(RunObserver):
    """Tells the listener. It is the last observer, so that an event comes after everything it announces is written."""

    run: str
    steps: int
    """Environment steps of the run."""
    listener: Listener
    _last: float = field(default=0.0, init=False)
    _busy: float = field(default=0.0, init=False)
    """Time of the last RunBusy event."""
    _trained: bool = field(default=False, init=False)
    """Whether training is complete."""
    _points: deque[tuple[float, int]] = field(default_factory=lambda: deque(maxlen=SPEED_WINDOW), init=False)
    """Seconds and steps of training at the latest events."""
    seconds_left: Callable[[float, int], float] = field(default=lambda seconds, _: seconds, init=False)
    """Seconds to the end of training and tests, given the seconds and steps of training left."""

    def announce(self, activity: str, done: int, total: int) -> None:
        """Tell how far a test or another activity is."""
        now = time.monotonic()
        if done in (0, total) or now - self._busy >= ADVANCE_SECONDS:
            self._busy = now
            left = self.seconds_left(0.0, 0) if self._trained else None
            self.listener(RunBusy(self.run, activity, done, total, left))

    @override
    def progressed(self, progress: Progress) -> None:
        self._trained = progress.steps >= self.steps
        now = time.monotonic()
        if now - self._last >= ADVANCE_SECONDS:
            self._last = now
            counts = progress.steps, progress.updates, progress.episodes
            left = self._estimate_seconds_left(progress)
            self.listener(RunAdvanced(self.run, *counts, progress.seconds, progress.warming_up, left))

    def _estimate_seconds_left(self, progress: Progress) -> float | None:
        if progress.warming_up:  # the rounds that learn take longer
            return None
        self._points.append((progress.seconds, progress.steps))
        (start, steps), (end, more_steps) = self._points[0], self._points[-1]
        if more_steps == steps:
            return None
        left = self.steps - progress.steps
        return self.seconds_left((end - start) / (more_steps - steps) * left, left)

    @override
    def tested(self, training: Training, test: DueTest, result: TestResult) -> None:
        self.listener(RunTested(self.run, result))

    @override
    def final_tested(self, final: FinalTest) -> None:
        self.listener(RunFinalTested(self.run, final))

    @override
    def ended(self, ending: Ending) -> None:
        self.listener(RunEnded(self.run, ending.state, ending.error, ending.traceback))
