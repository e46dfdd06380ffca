"""The outcome of a sweep and the events during it, as frozen values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from ..experiment.events import RunWarned
from ..records.sweep_records import SweepRecord, Trial


@dataclass(frozen=True)
class SweepOutcome(SweepRecord):
    """The sweep after a call of `Search.run`."""

    front: tuple[Trial, ...] = ()
    """The Pareto front of the objectives."""
    stop_code: int = 0
    left: bool = False
    """Whether the final phase was stopped before its end; `final` is then that of an earlier call."""

    @property
    def exit_code(self) -> int:
        """0: at least one trial is complete; 1: no trial is; 128 + signal or 124: stopped before the end."""
        if self.stop_code and (self.ended < self.asked or self.left):
            return self.stop_code
        return 0 if self.best is not None else 1


@dataclass(frozen=True)
class TrialEvent:
    """A trial, when `done` of `asked` trials have ended."""

    trial: Trial
    done: int
    asked: int
    best: Trial | None
    """The best trial so far by the first objective."""


class TrialBegan(TrialEvent):
    """A trial begins, or resumes after an interruption of the sweep."""


class TrialEnded(TrialEvent):
    """A trial has ended."""


@dataclass(frozen=True)
class FinalBegan:
    """Runs of the final phase begin, on seeds that were not used for tuning."""

    trials: tuple[int, ...]
    seeds: tuple[int, ...]
    purpose: Literal["choose", "report"]


SweepEvent = TrialBegan | TrialEnded | FinalBegan | RunWarned
SweepListener = Callable[[SweepEvent], None]
