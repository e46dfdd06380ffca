"""What is known of a sweep, as frozen values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from ..events import RunWarned
from ..spec import Sweep

State = Literal["running", "complete", "pruned", "failed"]


@dataclass(frozen=True)
class Trial:
    """One trial: what was drawn, and what came of it."""

    number: int
    """From 0."""
    name: str
    """Of its runs."""
    state: State
    drawn: Mapping[str, Any]
    """Parameter -> number, or label of a choice; parameters whose condition did not hold are missing."""
    values: tuple[float, ...] | None
    """One for each objective; None unless complete."""
    runs: tuple[str, ...]
    """Ids of its runs, in the order of the seeds."""
    error: str | None

    def row(self) -> dict[str, Any]:
        """As JSON values."""
        return asdict(self) | {"values": self.values and list(self.values), "runs": list(self.runs)}


@dataclass(frozen=True)
class Final:
    """The best trials on seeds that they were not tuned on."""

    chosen: int
    """Number of the trial that did best on the fresh seeds."""
    seeds: tuple[int, ...]
    report_seeds: tuple[int, ...]
    tuned: tuple[float, ...]
    """The chosen trial's objectives on the sweep's seeds, by which it came among the best: too good on the whole."""
    fresh: Mapping[int, tuple[float, ...]]
    """Trial -> objectives on the fresh seeds; a trial that failed there is missing."""
    reported: tuple[float, ...] | None
    """The chosen trial's objectives on seeds used for nothing else; None where a run failed."""

    def row(self) -> dict[str, Any]:
        """As JSON values; `gap` is tuned minus reported, one for each objective."""
        gap = None
        if self.reported is not None:
            gap = [tuned - reported for tuned, reported in zip(self.tuned, self.reported, strict=True)]
        return asdict(self) | {
            "fresh": {str(number): list(values) for number, values in self.fresh.items()},
            "gap": gap,
        }


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
    final: Final | None
    folder: Path
    stop_code: int = 0

    @property
    def objectives(self) -> tuple[str, ...]:
        return self.sweep.objectives

    def settings(self, trial: Trial) -> dict[str, Any]:
        """What a trial drew, every parameter of the sweep; None for those that it did not draw."""
        return {key: trial.drawn.get(key) for key in self.sweep.space}

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
