"""What a run tells whoever watches it. Plain values that can cross a process boundary."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..records.results import TestResult


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
    """Some rounds further; sent a few times a second at most."""

    run: str
    steps: int
    updates: int
    episodes: int
    seconds: float
    warming_up: bool


@dataclass(frozen=True)
class RunTested:
    """A test has ended and stands in the run folder."""

    run: str
    result: TestResult


@dataclass(frozen=True)
class RunWarned:
    """Something went wrong that the run can go on without."""

    run: str
    warning: str


@dataclass(frozen=True)
class RunEnded:
    """The run will write no more. `traceback` stands there when the fault is karolos' or a plugin's."""

    run: str
    state: str
    error: str | None = None
    traceback: str | None = None


RunEvent = RunStarted | RunAdvanced | RunTested | RunWarned | RunEnded
Listener = Callable[[RunEvent], None]
