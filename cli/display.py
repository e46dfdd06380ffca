"""What a person sees while runs and sweeps go on, always on stderr: live bars on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
from collections import defaultdict, deque
from contextlib import AbstractContextManager
from datetime import timedelta
from typing import TYPE_CHECKING, TextIO

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
)
from karolos.report.tables import clean

from .output import drawn_text

if TYPE_CHECKING:
    from karolos.records.final_test import FinalTest
    from karolos.records.results import TestResult
    from karolos.records.sweep_records import Trial
    from karolos.sweep.events import SweepEvent

WIDE = 130
"""Characters of a terminal that shows everything beside a bar."""
SWEEP_SPEED_SECONDS = 600.0
"""Seconds over which the speed of a sweep is averaged for the time left."""
SPEED_WINDOW = 50
"""Events over which speeds are averaged: about five seconds."""


class Speed:
    """Steps and updates per second of training over the last few seconds, as text."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, int, int]] = deque(maxlen=SPEED_WINDOW)
        self.text = ""

    def add(self, event: RunAdvanced) -> None:
        self._points.append((event.seconds, event.steps, event.updates))
        (start, steps, updates), (end, more_steps, more_updates) = self._points[0], self._points[-1]
        passed = end - start
        if passed > 0:
            learning = "warm-up" if event.warming_up else f"{(more_updates - updates) / passed:,.0f} updates/s"
            self.text = f"{(more_steps - steps) / passed:,.0f} steps/s, {learning}"


class Quiet(AbstractContextManager["Quiet"]):
    """Shows only warnings and failures."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._console = Console(file=stream or sys.stderr, stderr=stream is None, highlight=False, markup=False)
        self._speeds: defaultdict[str, Speed] = defaultdict(Speed)

    def __exit__(self, *_: object) -> None: ...

    def __call__(self, event: RunEvent) -> None:
        if isinstance(event, RunAdvanced):
            self._speeds[event.run].add(event)
        elif isinstance(event, RunWarned):
            self._print(f"{event.run} warning: {event.warning}")
        elif isinstance(event, RunEnded) and event.error:
            if event.traceback:
                self._print(event.traceback.rstrip())
            self._print(f"{event.run} failed: {event.error}")

    def _print(self, text: str) -> None:
        self._console.print(text, soft_wrap=True)


class Plain(Quiet):
    """Shows one line per start of a run, test and end of a run: for logs and pipes."""

    def __call__(self, event: RunEvent) -> None:
        super().__call__(event)
        if isinstance(event, RunStarted):
            self._print(f"{event.run} started: {event.steps:,} steps into {event.folder}")
        elif isinstance(event, RunTested):
            result, speed = event.result, self._speeds[event.run].text
            line = f"{event.run} at {result.steps:,} steps, {result.seconds:.1f} s: {result.score}"
            self._print(f"{line} ({speed})" if speed else line)
        elif isinstance(event, RunFinalTested):
            self._print(f"{event.run} final test: {_final(event.final)}")
        elif isinstance(event, RunEnded) and not event.error:
            self._print(f"{event.run} {event.state}")


class Live(Quiet):
    """Shows a bar per run: steps, speeds, activity, score of the last test, time left with tests."""

    def __init__(self, stream: TextIO | None = None) -> None:
        super().__init__(stream)
        self._narrow = self._console.width < WIDE
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=12 if self._narrow else 24),
            MofNCompleteColumn(),
            TextColumn("{task.fields[speed]}", style="cyan"),
            TextColumn("{task.fields[activity]}", style="yellow"),
            TextColumn("{task.fields[score]}", style="green"),
            TextColumn("{task.fields[left]}"),
            console=self._console,
        )
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> Live:
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()

    def __call__(self, event: RunEvent) -> None:
        super().__call__(event)
        bars = self._bars
        if isinstance(event, RunStarted):
            task = bars.add_task(
                f"seed {event.seed}", total=event.steps, speed="starting", activity="", score="", left=""
            )
            self._tasks[event.run] = task
            return
        if event.run not in self._tasks:  # its process died before the run began
            return
        task = self._tasks[event.run]
        if isinstance(event, RunAdvanced):
            left = _left(event.seconds_left)
            speed = self._speeds[event.run].text
            speed = speed.partition(",")[0] if self._narrow else speed
            bars.update(task, completed=event.steps, speed=speed, left=left)
        elif isinstance(event, RunBusy) and event.seconds_left is None:
            bars.update(task, activity=_activity(event))
        elif isinstance(event, RunBusy):  # the speed of training says nothing any more
            bars.update(task, activity=_activity(event), left=_left(event.seconds_left), speed="")
        elif isinstance(event, RunTested):
            if event.result.steps > bars.tasks[task].completed:  # training may have gone on since the test was due
                bars.update(task, completed=event.result.steps)
            bars.update(task, score=_brief(event.result) if self._narrow else event.result.score)
        elif isinstance(event, RunFinalTested):
            bars.update(task, score=_brief(event.final.last) if self._narrow else _final(event.final))
        elif isinstance(event, RunEnded):
            bars.update(task, speed=event.state, activity="", left="")
            bars.stop_task(task)


def _left(seconds: float | None) -> str:
    return "" if seconds is None else f"{timedelta(seconds=round(seconds))} left"


def _activity(event: RunBusy) -> str:
    """What a run does beside training, and how far it is; empty when it is done."""
    if event.done == event.total:
        return ""
    return event.activity if event.total == 1 else f"{event.activity} {event.done}/{event.total}"


def _final(final: FinalTest) -> str:
    """The scores of the policies `last` and `best`."""
    last, best = final.last.score, final.best
    if best is None:
        return last
    return f"{last}; best {_brief(best)}"


def _brief(result: TestResult) -> str:
    """The score in a few characters."""
    return f"end {result.success_end:.2f}" if result.has_success else f"return {result.mean_return:,.2f}"


def choose_display(*, quiet: bool) -> Quiet:
    """Live bars on a terminal, plain lines elsewhere; only warnings and failures if quiet."""
    if quiet:
        return Quiet()
    return Live() if sys.stderr.isatty() else Plain()


class SweepDisplay(AbstractContextManager["SweepDisplay"]):
    """Shows one line per trial, and on a terminal a bar: trials, the best so far, the time left.

    Elsewhere a trial's start has a line as well. Shows only warnings and failures if quiet.
    """

    def __init__(self, objectives: tuple[str, ...], *, quiet: bool, stream: TextIO | None = None) -> None:
        self._objectives = objectives
        self._quiet = quiet
        self._console = Console(file=stream or sys.stderr, stderr=stream is None, highlight=False, markup=False)
        self._bar: Progress | None = None
        if self._console.is_terminal and not quiet:
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(bar_width=24),
                TextColumn("{task.fields[done]}"),
                TextColumn("{task.fields[best]}", style="green"),
                TimeRemainingColumn(),
                TextColumn("left"),
                console=self._console,
                speed_estimate_period=SWEEP_SPEED_SECONDS,
            )
            self._task = self._bar.add_task("trials", total=None, done="", best="")
        self._ended = 0
        """Trials of this phase that have ended."""
        self._fractions: dict[str, float] = {}
        """Trials that have not ended, by name -> fraction of their steps."""

    def __enter__(self) -> SweepDisplay:
        if self._bar:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar:
            self._bar.stop()

    def __call__(self, event: SweepEvent) -> None:
        from karolos.sweep.events import TrialAdvanced, TrialBegan, TrialEnded

        if isinstance(event, RunWarned):
            self._print(f"{event.run}: {event.warning}")
        elif isinstance(event, TrialEnded) and event.trial.state == "failed":
            self._print(f"trial {event.trial.number} failed: {event.trial.error} [{event.done}/{event.asked}]")
        elif self._quiet:
            return
        elif isinstance(event, TrialBegan) and not self._bar:
            self._print(f"trial {event.trial.number}: {drawn_text(event.trial)}")
        elif isinstance(event, TrialEnded):
            found = self._values(event.trial)
            text = f"{event.trial.state}: {found}" if found else event.trial.state
            drawn = f" with {drawn_text(event.trial)}" if self._bar else ""
            self._print(f"trial {event.trial.number} {text}{drawn} [{event.done}/{event.asked}]")
        elif not isinstance(event, TrialBegan | TrialAdvanced):
            seeds = ", ".join(map(str, event.seeds))
            self._print(f"trials {', '.join(map(str, event.trials))} on seeds {seeds}, to {event.purpose}")
        if self._bar:
            self._update(self._bar, event)

    def _update(self, bar: Progress, event: SweepEvent) -> None:
        from karolos.sweep.events import FinalBegan, TrialAdvanced, TrialBegan, TrialEnded

        if isinstance(event, TrialAdvanced):
            self._fractions[event.name] = event.fraction
        elif isinstance(event, TrialBegan | TrialEnded):
            self._fractions.pop(event.trial.name, None)
            best = event.best and f"best {self._values(event.best)} (trial {event.best.number})"
            done = f"{event.done}/{event.asked}"
            bar.update(self._task, total=event.asked, done=done, best=best or "")
            self._ended = event.done
        elif isinstance(event, FinalBegan):
            self._fractions.clear()
            self._ended = 0
            doing = "choosing" if event.purpose == "choose" else "reporting"
            done, best = f"{len(event.seeds)} seeds each", bar.tasks[0].fields["best"]
            bar.reset(self._task, description=doing, total=len(event.trials), done=done, best=best)
        bar.update(self._task, completed=self._ended + sum(self._fractions.values()))

    def _values(self, trial: Trial) -> str:
        return ", ".join(
            f"{name} {value:.4g}" for name, value in zip(self._objectives, trial.values or (), strict=False)
        )

    def _print(self, text: str) -> None:
        self._console.print(clean(text), soft_wrap=True)
