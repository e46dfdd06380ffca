"""Progress of runs and sweeps for a person, always on stderr: live bars on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections import defaultdict, deque
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, Self, TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from karolos.experiment.events import (
    RunAdvanced,
    RunBusy,
    RunEnded,
    RunEvent,
    RunFinalTested,
    RunStarted,
    RunTested,
    RunWarned,
    text_of,
)
from karolos.records.sweep_records import FinalBegan, TrialChanged
from karolos.report.tables import clean

from .output import drawn_text

if TYPE_CHECKING:
    from karolos.records.sweep_records import Trial

SWEEP_SPEED_SECONDS = 600.0
"""Seconds over which the speed of a sweep is averaged, to estimate the time left."""
PLAIN_SECONDS = 5.0
"""Time between two lines of a run without a terminal."""
SPEED_WINDOW = 50
"""Number of events over which speeds are averaged: about five seconds."""


class Quiet(AbstractContextManager[Any]):
    """Shows only warnings and failures, as lines on stderr or another stream, above any bars."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._console = Console(file=stream or sys.stderr, stderr=stream is None, highlight=False, markup=False)
        self._bars: Progress | None = None

    def __enter__(self) -> Self:
        if self._bars:
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bars:
            self._bars.stop()

    def _print(self, text: str) -> None:
        self._console.print(clean(text, allowed="\n\t"), soft_wrap=True)

    def __call__(self, event: Any) -> None:
        if isinstance(event, RunEnded) and event.traceback:
            self._print(event.traceback.rstrip())
        if isinstance(event, RunWarned) or (isinstance(event, RunEnded) and event.error):
            self._print(f"{event.run} {text_of(event)}")
        elif isinstance(event, TrialChanged) and event.trial.state == "failed":
            self._print(f"trial {event.trial.number} failed: {event.trial.error} [{event.done}/{event.asked}]")


class Plain(Quiet):
    """Shows one line per start, test and end of a run, and its progress: for logs and pipes."""

    def __init__(self, stream: TextIO | None = None) -> None:
        super().__init__(stream)
        self._points: dict[str, list[RunAdvanced]] = {}
        """Run -> progress of training at the last line, and now."""
        self._steps: dict[str, int] = {}
        """Run -> requested steps."""
        self._said: dict[str, float] = {}
        """Time of each run's last line."""

    def __call__(self, event: Any) -> None:
        super().__call__(event)
        if isinstance(event, RunStarted):
            self._steps[event.run] = event.steps
        if isinstance(event, RunAdvanced | RunBusy):
            if isinstance(event, RunAdvanced):
                self._points[event.run] = [*self._points.get(event.run, [event])[:1], event]
            if time.monotonic() - self._said.setdefault(event.run, time.monotonic()) < PLAIN_SECONDS:
                return
            self._print(self._progress(event))
            self._points[event.run] = self._points.get(event.run, [])[-1:]
        elif isinstance(event, RunTested):
            points = self._points.get(event.run, [])
            speed = f" ({found})" if (found := _speed(points)) else ""
            self._print(f"{event.run} {text_of(event)}{speed}")
            self._points[event.run] = points[-1:]
        elif isinstance(event, RunStarted | RunFinalTested) or (isinstance(event, RunEnded) and not event.error):
            self._print(f"{event.run} {text_of(event)}")
        if isinstance(event, RunEvent):
            self._said[event.run] = time.monotonic()

    def _progress(self, event: RunAdvanced | RunBusy) -> str:
        """Progress and speed of a run, and its activity while it does not train."""
        points = self._points.get(event.run, [])
        steps, seconds = (points[-1].steps, points[-1].seconds) if points else (0, 0.0)
        doing = _activity(event) if isinstance(event, RunBusy) else _speed(points)
        line = f"{event.run} at {steps:,} of {self._steps.get(event.run, 0):,} steps, {seconds:.1f} s"
        return f"{line} ({doing})" if doing else line


class Live(Quiet):
    """Shows a bar per run: steps, speeds, activity, score of the last test, time left."""

    def __init__(self, stream: TextIO | None = None) -> None:
        super().__init__(stream)
        self._bars: Progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=12),
            MofNCompleteColumn(),
            TextColumn("{task.fields[speed]}", style="cyan"),
            TextColumn("{task.fields[activity]}", style="yellow"),
            TextColumn("{task.fields[score]}", style="green"),
            TimeRemainingColumn(),
            TextColumn("left"),
            console=self._console,
        )
        self._tasks: dict[str, TaskID] = {}
        self._points: defaultdict[str, deque[RunAdvanced]] = defaultdict(lambda: deque(maxlen=SPEED_WINDOW))

    def __call__(self, event: Any) -> None:
        super().__call__(event)
        if isinstance(event, RunStarted):
            fields: dict[str, Any] = {"speed": "starting", "activity": "", "score": ""}
            self._tasks[event.run] = self._bars.add_task(f"seed {event.seed}", total=event.steps, **fields)
        elif event.run in self._tasks:  # otherwise its process died before the run began
            task = self._tasks[event.run]
            self._bars.update(task, **self._changes(event, self._bars.tasks[task].completed))
            if isinstance(event, RunEnded):
                self._bars.stop_task(task)

    def _changes(self, event: RunEvent, completed: float) -> dict[str, Any]:
        """The fields of a run's bar that an event changes."""
        if isinstance(event, RunAdvanced):
            self._points[event.run].append(event)
            speed, _, _ = _speed(self._points[event.run]).partition(",")
            return {"completed": event.steps, "speed": speed}
        if isinstance(event, RunBusy):
            return {"activity": _activity(event)}
        if isinstance(event, RunTested):  # training may have gone on since the test was due
            return {"completed": max(event.result.steps, completed), "score": event.result.brief}
        if isinstance(event, RunFinalTested):
            return {"score": event.final["last"].brief}
        return {"speed": event.state, "activity": ""} if isinstance(event, RunEnded) else {}


def _speed(points: Sequence[RunAdvanced]) -> str:
    """Steps and updates per second of training from the first to the last of some events; empty if no time passed."""
    if not points or (passed := points[-1].seconds - points[0].seconds) <= 0:
        return ""
    first, last = points[0], points[-1]
    learning = "warm-up" if last.warming_up else f"{(last.updates - first.updates) / passed:,.0f} updates/s"
    return f"{(last.steps - first.steps) / passed:,.0f} steps/s, {learning}"


def _activity(event: RunBusy) -> str:
    """Activity of a run other than training, with its progress; empty when it is done."""
    if event.done == event.total:
        return ""
    return event.activity if event.total == 1 else f"{event.activity} {event.done}/{event.total}"


def _named(what: str, numbers: Sequence[int]) -> str:
    """ "trial 0", or "seeds 3, 4"."""
    return f"{what}{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"


def choose_display(*, quiet: bool) -> Quiet:
    """Live bars on a terminal, plain lines elsewhere; only warnings and failures if quiet."""
    if quiet:
        return Quiet()
    return Live() if sys.stderr.isatty() else Plain()


class SweepDisplay(Quiet):
    """Shows one line per trial, and on a terminal a bar: trials, the best so far, the time left.

    Without a terminal a trial's start also has a line.
    """

    def __init__(self, objectives: tuple[str, ...], stream: TextIO | None = None) -> None:
        super().__init__(stream)
        self._objectives = objectives
        if self._console.is_terminal:
            self._bars = Progress(
                TextColumn("{task.description}"),
                BarColumn(bar_width=24),
                TextColumn("{task.fields[done]}"),
                TextColumn("{task.fields[best]}", style="green"),
                TimeRemainingColumn(),
                TextColumn("left"),
                console=self._console,
                speed_estimate_period=SWEEP_SPEED_SECONDS,
            )
            self._task = self._bars.add_task("trials", total=None, done="", best="")

    def __call__(self, event: Any) -> None:
        super().__call__(event)
        if isinstance(event, TrialChanged) and event.trial.state == "running":
            if not self._bars:
                self._print(f"trial {event.trial.number}: {drawn_text(event.trial)}")
        elif isinstance(event, TrialChanged) and event.trial.state != "failed":
            found = self._values(event.trial)
            text = f"{event.trial.state}: {found}" if found else event.trial.state
            drawn = f" with {drawn_text(event.trial)}" if self._bars else ""
            self._print(f"trial {event.trial.number} {text}{drawn} [{event.done}/{event.asked}]")
        elif isinstance(event, FinalBegan):
            self._print(f"{_named('trial', event.trials)} on {_named('seed', event.seeds)}, to {event.purpose}")
        if self._bars:
            self._update(self._bars, event)

    def _update(self, bar: Progress, event: TrialChanged | FinalBegan | RunWarned) -> None:
        if isinstance(event, TrialChanged):
            best = event.best and f"best {self._values(event.best)} (trial {event.best.number})"
            done = f"{event.done}/{event.asked}"
            bar.update(self._task, total=event.asked, completed=event.done, done=done, best=best or "")
        elif isinstance(event, FinalBegan):
            doing = "choosing" if event.purpose == "choose" else "reporting"
            done, best = f"{_named('seed', event.seeds)} each", bar.tasks[0].fields["best"]
            bar.reset(self._task, description=doing, total=len(event.trials), done=done, best=best)

    def _values(self, trial: Trial) -> str:
        values = zip(self._objectives, trial.values or (), strict=False)
        return ", ".join(f"{name} {value:.4g}" for name, value in values)
