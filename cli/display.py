"""What a person sees while runs and sweeps go on, always on stderr: live bars on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
from collections import deque
from contextlib import ExitStack
from types import TracebackType
from typing import TYPE_CHECKING, TextIO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from karolos.experiment.events import RunAdvanced, RunEnded, RunEvent, RunStarted, RunTested, RunWarned

from .output import say
from .sweep import drawn_text

if TYPE_CHECKING:
    from karolos.sweep.events import SweepEvent

SPEED_WINDOW = 50
"""Events over which speeds are averaged: about five seconds."""


class Speed:
    """Steps and updates per second of training over the last few seconds."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, int, int]] = deque(maxlen=SPEED_WINDOW)

    def add(self, event: RunAdvanced) -> str:
        self._points.append((event.seconds, event.steps, event.updates))
        (start, steps, updates), (end, more_steps, more_updates) = self._points[0], self._points[-1]
        passed = end - start
        if passed <= 0:
            return ""
        text = f"{(more_steps - steps) / passed:,.0f} steps/s"
        if event.warming_up:
            return f"{text}, warm-up"
        return f"{text}, {(more_updates - updates) / passed:,.0f} updates/s"


class Quiet:
    """Shows only warnings and failures."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._console = Console(file=stream or sys.stderr, stderr=stream is None, highlight=False, markup=False)

    def __enter__(self) -> Quiet:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def __call__(self, event: RunEvent) -> None:
        if isinstance(event, RunWarned):
            self._console.print(f"{event.run} warning: {event.warning}", soft_wrap=True)
        if isinstance(event, RunEnded) and event.error:
            if event.traceback:
                self._console.print(event.traceback.rstrip(), soft_wrap=True)
            self._console.print(f"{event.run} failed: {event.error}", soft_wrap=True)


class Plain(Quiet):
    """Shows one line per start of a run, test and end of a run: for logs and pipes."""

    def __init__(self, stream: TextIO | None = None) -> None:
        super().__init__(stream)
        self._speeds: dict[str, tuple[Speed, str]] = {}

    def __call__(self, event: RunEvent) -> None:
        super().__call__(event)
        if isinstance(event, RunStarted):
            self._line(f"{event.run} started: {event.steps:,} steps into {event.folder}")
        elif isinstance(event, RunAdvanced):
            speed = self._speeds.get(event.run, (Speed(), ""))[0]
            self._speeds[event.run] = (speed, speed.add(event))
        elif isinstance(event, RunTested):
            result = event.result
            speed_text = self._speeds.get(event.run, (None, ""))[1]
            self._line(
                f"{event.run} at {result.steps:,} steps, {result.seconds:.1f} s: "
                f"success any {result.success_any:.2f}, end {result.success_end:.2f}"
                + (f" ({speed_text})" if speed_text else "")
            )
        elif isinstance(event, RunEnded) and not event.error:
            self._line(f"{event.run} {event.state}")

    def _line(self, text: str) -> None:
        self._console.print(text, soft_wrap=True)


class Live(Quiet):
    """Shows a bar per run: steps, speeds, last success ratio, time left."""

    def __init__(self, stream: TextIO | None = None) -> None:
        super().__init__(stream)
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TextColumn("{task.fields[speed]}", style="cyan"),
            TextColumn("{task.fields[success]}", style="green"),
            TimeRemainingColumn(),
            console=self._console,
        )
        self._tasks: dict[str, TaskID] = {}
        self._speeds: dict[str, Speed] = {}
        self._stack = ExitStack()

    def __enter__(self) -> Live:
        self._stack.enter_context(self._bars)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def __call__(self, event: RunEvent) -> None:
        super().__call__(event)
        bars = self._bars
        if isinstance(event, RunStarted):
            self._speeds[event.run] = Speed()
            self._tasks[event.run] = bars.add_task(
                f"seed {event.seed}", total=event.steps, speed="starting", success=""
            )
            return
        task = self._tasks[event.run]
        if isinstance(event, RunAdvanced):
            bars.update(task, completed=event.steps, speed=self._speeds[event.run].add(event))
        elif isinstance(event, RunTested):
            result = event.result
            text = f"success any {result.success_any:.2f} end {result.success_end:.2f}"
            bars.update(task, completed=result.steps, success=text)
        elif isinstance(event, RunEnded):
            bars.update(task, speed=event.state)
            bars.stop_task(task)


def choose_display(*, quiet: bool) -> Quiet:
    """Live bars on a terminal, plain lines elsewhere; only warnings and failures if quiet."""
    if quiet:
        return Quiet()
    return Live() if sys.stderr.isatty() else Plain()


class SweepDisplay:
    """Shows one line per start and end of a trial; only warnings and failures if quiet."""

    def __init__(self, objectives: tuple[str, ...], *, quiet: bool) -> None:
        self._objectives = objectives
        self._quiet = quiet

    def __call__(self, event: SweepEvent) -> None:
        from karolos.sweep.events import TrialBegan, TrialEnded

        if isinstance(event, RunWarned):
            say(f"{event.run}: {event.warning}")
        elif isinstance(event, TrialEnded) and event.trial.state == "failed":
            say(f"trial {event.trial.number} failed: {event.trial.error} [{event.done}/{event.asked}]")
        elif self._quiet:
            return
        elif isinstance(event, TrialBegan):
            say(f"trial {event.trial.number}: {drawn_text(event.trial)}")
        elif isinstance(event, TrialEnded):
            values = zip(self._objectives, event.trial.values or (), strict=False)
            found = ", ".join(f"{name} {value:.4g}" for name, value in values)
            text = f"{event.trial.state}: {found}" if found else event.trial.state
            say(f"trial {event.trial.number} {text} [{event.done}/{event.asked}]")
        else:
            seeds = ", ".join(map(str, event.seeds))
            say(f"trials {', '.join(map(str, event.trials))} on seeds {seeds}, to {event.purpose}")
