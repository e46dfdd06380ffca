"""What a run tells its listener: plain values that can cross a process boundary, and how often it tells them."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..records.evaluation import Evaluation

if TYPE_CHECKING:
    from ..training.training import Progress

ADVANCE_SECONDS = 0.1
"""Minimal time between two RunAdvanced or two RunBusy events."""

WRITE_SECONDS = 4.0
"""Time after which the progress is written down again, so that whoever looks sees it every five seconds."""

Announce = Callable[[str, int, int], None]
"""Is called with an activity, and how much of it is done, of how much."""


@dataclass(frozen=True)
class RunLaunched:
    """A launcher has the run, which waits for its start. Runs of this process do not send it."""

    run: str


@dataclass(frozen=True)
class RunStarted:
    """The run has its folder and begins to build environments and agent."""

    run: str
    seed: int
    steps: int
    """Environment steps it will take."""
    folder: str


@dataclass(frozen=True)
class RunAdvanced:
    """Training has advanced; sent at most ten times a second."""

    run: str
    steps: int
    updates: int
    episodes: int
    seconds: float
    warming_up: bool


@dataclass(frozen=True)
class RunBusy:
    """The run does something else than training; sent at most ten times a second, and when it is done."""

    run: str
    activity: str
    """testing, final test, collecting demonstrations or checkpoint."""
    done: int
    total: int
    """Episodes, or 1 for a checkpoint."""


@dataclass(frozen=True)
class RunTested:
    """A test is over and written into the run folder."""

    run: str
    result: Evaluation


@dataclass(frozen=True)
class RunFinalTested:
    """The final test is over and written into the run folder."""

    run: str
    final: Mapping[str, Evaluation]
    """Checkpoint -> its test."""


@dataclass(frozen=True)
class RunWarned:
    """A problem that the run survives."""

    run: str
    warning: str


@dataclass(frozen=True)
class RunEnded:
    """The run is over. `traceback` is given if karolos or a plugin is at fault."""

    run: str
    state: str
    error: str | None = None
    traceback: str | None = None


RunEvent = RunLaunched | RunStarted | RunAdvanced | RunBusy | RunTested | RunFinalTested | RunWarned | RunEnded
Listener = Callable[[RunEvent], None]


class Announcer:
    """Tells the listener how far training and tests are.

    Args:
        run: its id.
        listener: is called with RunAdvanced and RunBusy.
    """

    def __init__(self, run: str, listener: Listener) -> None:
        self.run, self.listener = run, listener
        self.write: Callable[[], object] = lambda: None
        """Is called every WRITE_SECONDS to write down how far the run is."""
        self._advanced = self._busy = 0.0
        """Times of the last RunAdvanced and RunBusy event."""
        self._written = time.monotonic()

    def announce(self, activity: str, done: int, total: int) -> None:
        """Tell how far a test or another activity is."""
        now = time.monotonic()
        if done in (0, total) or now - self._busy >= ADVANCE_SECONDS:
            self._busy = now
            self.listener(RunBusy(self.run, activity, done, total))
            self._write(now)

    def progressed(self, progress: Progress, *, last: bool) -> None:
        """A round of training is over; `last`: and training is."""
        now = time.monotonic()
        if last or now - self._advanced >= ADVANCE_SECONDS:
            self._advanced = now
            counts = progress.steps, progress.updates, progress.episodes
            self.listener(RunAdvanced(self.run, *counts, progress.seconds, progress.warming_up))
            self._write(now)

    def _write(self, now: float) -> None:
        if now - self._written >= WRITE_SECONDS:
            self._written = now
            self.write()


def text_of(event: RunEvent) -> str | None:
    """A start, test, warning or end in one line, without the run; None for other events."""
    if isinstance(event, RunStarted):
        return f"started: {event.steps:,} steps into {event.folder}"
    if isinstance(event, RunTested):
        return f"at {event.result.steps:,} steps, {event.result.seconds:.1f} s: {event.result.text}"
    if isinstance(event, RunFinalTested):
        best = event.final.get("best")
        return f"final test: {event.final['last'].text}{f'; best {best.brief}' if best else ''}"
    if isinstance(event, RunWarned):
        return f"warning: {event.warning}"
    if isinstance(event, RunEnded):
        return event.state if event.error is None else f"failed: {event.error}"
    return None


def print_progress(event: RunEvent) -> None:
    """A listener that prints a line on stderr for each start, test, warning and end."""
    if (text := text_of(event)) is not None:
        print(f"{event.run} {text}", file=sys.stderr)
