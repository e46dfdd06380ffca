"""What becomes of a sweep, and what is told while it goes on, as frozen values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ..experiment.events import RunWarned
from ..records.sweep_records import SweepFinal, Trial
from ..spec import Sweep


@dataclass(frozen=True)
class Outcome:
    """What became of a sweep."""

    sweep: Sweep
    trials: tuple[Trial, ...]
    asked: int
    """How many trials the sweep is to have."""
    best: Trial | None
    """By the first objective; the one that `final` chose, where there is one."""
    front: tuple[Trial, ...]
    """The trials that no other beats in every objective; with one objective, the best."""
    final: SweepFinal | None
    folder: Path
    stop_code: int = 0

    @property
    def objectives(self) -> tuple[str, ...]:
        return self.sweep.objectives

    @property
    def exit_code(self) -> int:
        """0: it has its trials and one is complete; 1: none is; 128 + signal or 124 when stopped before."""
        done = sum(trial.state != "running" for trial in self.trials)
        if self.stop_code and (done < self.asked or (self.sweep.final is not None and self.final is None)):
            return self.stop_code
        return 0 if self.best is not None else 1


@dataclass(frozen=True)
class TrialBegan:
    """A trial begins, or goes on after the sweep was interrupted."""

    trial: Trial


@dataclass(frozen=True)
class TrialEnded:
    """A trial has ended; `done` of `asked` have."""

    trial: Trial
    done: int
    asked: int


@dataclass(frozen=True)
class FinalBegan:
    """Trials are run on seeds that they were not tuned on."""

    trials: tuple[int, ...]
    seeds: tuple[int, ...]
    purpose: Literal["choose", "report"]


SweepEvent = TrialBegan | TrialEnded | FinalBegan | RunWarned
SweepListener = Callable[[SweepEvent], None]
