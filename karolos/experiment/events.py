"""Events of a run for its listener: plain values that can cross a process boundary."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass

from ..records.evaluation import Evaluation


@dataclass(frozen=True)
class RunLaunched:
    """A launcher has accepted the run, which waits for its start. Runs in this process do not send it."""

    run: str


@dataclass(frozen=True)
class RunStarted:
    """The run has its folder and starts to build environments and agent."""

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
    """The run does something other than training; sent at most ten times a second, and at its end."""

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
        with suppress(OSError):  # a full disk or a reader that has ended ends no run
            print(f"{event.run} {text}", file=sys.stderr)
