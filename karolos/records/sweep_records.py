"""A sweep as frozen values, read from the folder that `karolos.plans.sweep` writes. Needs no Optuna."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from pydantic import FiniteFloat

from ..errors import RunError, UsageError, closest
from ..system.files import FileLock, read_object, read_values
from .decode import from_json, read_json
from .evaluation import Count
from .run_folder import paths
from .run_records import ID, SWEEPS, RunSummary

FOLDER = SWEEPS
DESCRIPTION, TRIALS, FINAL = "sweep.json", "trials.jsonl", "final.json"
BEST = "best.yaml"
"""The best trial as a spec."""
FORMAT = 1
"""Version of the folder's layout, in sweep.json."""
LOCK = "lock"
"""The file that the process of a running sweep holds locked."""
_DESCRIBED = (
    *("name", "experiment", "created", "asked", "wants_final"),
    *("objectives", "directions", "parameters", "seeds"),
)
"""Fields of SweepRecord in sweep.json, in addition to its id."""
_OF_SWEEP = re.compile(r"(.+)-(?:t\d{3,}|best)")
"""Pattern of the name of a sweep's run: of a trial, or of the best trial as a spec."""
SweepTrialState = Literal["running", "complete", "pruned", "failed"]


def best_name(sweep: str) -> str:
    """The name of the spec, and of its runs, that a sweep of this name writes for its best trial."""
    return f"{sweep}-best"


@dataclass(frozen=True)
class Trial:
    """One trial of a sweep: its settings and its result."""

    number: Count
    name: str
    """Name of its runs."""
    state: SweepTrialState
    """`running` until the trial ends, even while the sweep is interrupted."""
    drawn: Mapping[str, Any]
    """Parameter -> number, or label of a choice; a parameter whose condition does not hold is missing."""
    values: tuple[FiniteFloat, ...] | None
    """One per objective; None unless the trial is complete."""
    runs: tuple[str, ...]
    """Ids of its runs, in the order of the seeds; empty until it ends."""
    error: str | None

    def row(self) -> dict[str, Any]:
        """As JSON values."""
        return asdict(self)


@dataclass(frozen=True)
class SweepFinal:
    """The best trials on new seeds."""

    chosen: int
    """Number of the trial that is best on the new seeds."""
    seeds: tuple[int, ...]
    report_seeds: tuple[int, ...]
    tuned: tuple[FiniteFloat, ...]
    """The chosen trial's objectives on the sweep's seeds; biased upwards, because it was selected by them."""
    fresh: Mapping[int, tuple[FiniteFloat, ...]]
    """Trial -> objectives on the new seeds; a trial that failed on them is missing."""
    reported: tuple[FiniteFloat, ...] | None
    """The chosen trial's objectives on the reporting seeds, which have no other use; None if a run failed."""

    def row(self) -> dict[str, Any]:
        """As JSON values; `gap` is tuned minus reported, one per objective."""
        gap = self.reported and [tuned - reported for tuned, reported in zip(self.tuned, self.reported, strict=True)]
        return asdict(self) | {"gap": gap}


@dataclass(frozen=True)
class SweepRecord:
    """A search over a spec's settings, with its trials so far."""

    sweep: str
    """Id: its name and start time."""
    name: str
    experiment: str
    """Hash of the spec whose settings are searched."""
    objectives: tuple[str, ...]
    """The objectives of trials, the most important first."""
    directions: tuple[str, ...]
    """maximize or minimize, one per objective."""
    parameters: tuple[str, ...]
    """Key paths of the searched settings."""
    seeds: tuple[int, ...]
    """The seeds of every trial."""
    asked: Count
    """Number of trials that it shall have."""
    wants_final: bool
    """Whether the best trials shall run on new seeds."""
    created: str
    """ISO 8601, UTC."""
    folder: str
    trials: tuple[Trial, ...] = ()
    """Trials by number."""
    final: SweepFinal | None = None

    @property
    def ended(self) -> int:
        """Number of trials that have ended."""
        return sum(trial.state != "running" for trial in self.trials)

    @property
    def ranked(self) -> list[Trial]:
        """The complete trials, the best first: by the first objective, then the next, then by number."""
        found = [
            (merit(trial.values, self.directions), trial.number, trial)
            for trial in self.trials
            if trial.values is not None
        ]
        return [trial for *_, trial in sorted(found, key=lambda each: each[:2])]

    @property
    def best(self) -> Trial | None:
        """The trial that `final` chose; without it, the first of `ranked`."""
        if self.final is not None:
            return next((trial for trial in self.trials if trial.number == self.final.chosen), None)
        return next(iter(self.ranked), None)

    def reports(self, name: str, seed: int) -> bool:
        """Whether a run is an unbiased result of the sweep's settings: its seed was not used to tune or choose them."""
        if name == best_name(self.name):
            return seed not in {*self.seeds, *(self.final.seeds if self.final else ())}
        return (
            self.final is not None
            and self.best is not None
            and (name == self.best.name and seed in self.final.report_seeds)
        )

    def state(self) -> str:
        """The current state: running; finished; or stopped, if trials are missing and no process runs it."""
        if FileLock(Path(self.folder) / LOCK).is_locked():
            return "running"
        missing = self.ended < self.asked or (self.wants_final and self.final is None and bool(self.ranked))
        return "stopped" if missing else "finished"

    def description(self) -> dict[str, Any]:
        """The content of sweep.json."""
        return {"format": FORMAT, "id": self.sweep} | {name: getattr(self, name) for name in _DESCRIBED}

    def row(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "sweep": self.sweep,
            "state": self.state(),
            **{name: getattr(self, name) for name in _DESCRIBED},
            "folder": self.folder,
            "best": self.best.number if self.best else None,
            "final": self.final.row() if self.final else None,
            "trials": [trial.row() for trial in self.trials],
        }


@dataclass(frozen=True)
class TrialChanged:
    """An event of a sweep: a trial begins or continues (its state is running), or has ended."""

    trial: Trial
    done: int
    """Number of trials that have ended."""
    asked: int
    """Number of trials that the sweep shall have."""
    best: Trial | None
    """The best trial so far by the first objective."""


@dataclass(frozen=True)
class FinalBegan:
    """An event of a sweep: runs of the final phase begin, on new seeds."""

    trials: tuple[int, ...]
    seeds: tuple[int, ...]
    purpose: Literal["choose", "report"]


def merit(values: Sequence[float], directions: Sequence[str]) -> tuple[float, ...]:
    """Objectives with signs, so that smaller is better."""
    return tuple(
        -value if direction == "maximize" else value for value, direction in zip(values, directions, strict=True)
    )


def sweep_folder(run: RunSummary) -> Path | None:
    """The folder of the sweep that a run belongs to, by its name; None without one."""
    found = _OF_SWEEP.fullmatch(run.name)
    folder = Path(run.folder).parent / FOLDER / found[1] if found else None
    return folder if folder is not None and os.path.isfile(folder / DESCRIPTION) else None


def is_trial(run: RunSummary) -> bool:
    """Whether a run belongs to a trial of a sweep."""
    return not run.name.endswith(best_name("")) and sweep_folder(run) is not None


def sweeps(runs: str | Path, name: str | None = None) -> tuple[list[SweepRecord], tuple[str, ...]]:
    """The sweeps in a runs folder, the newest first, or those of this name or id; and one line per damaged file."""
    found: list[SweepRecord] = []
    problems: list[str] = []
    for path in paths(Path(runs) / FOLDER, description=DESCRIPTION):
        try:
            record, damaged = read_sweep(path)
        except RunError as error:
            problems.append(str(error))
            continue
        problems += damaged
        if name in (None, record.name, record.sweep):
            found.append(record)
    return sorted(found, key=lambda record: (record.created, record.sweep), reverse=True), tuple(problems)


def find_sweep(runs: str | Path, name: str) -> SweepRecord:
    """The one sweep of this name or id in a runs folder. Raises UsageError if there is none, or several."""
    found, _ = sweeps(runs, name)
    if not found:
        like = closest(name, {record.name for record in sweeps(runs)[0]})
        hint = "`karolos sweeps list` shows them"
        raise UsageError(f"there is no sweep {name!r}", hint=f"did you mean {like!r}? {hint}" if like else hint)
    if len(found) > 1:
        raise UsageError(f"{name!r} means several sweeps", hint=f"one of {', '.join(one.sweep for one in found[:5])}")
    return found[0]


def read_sweep(folder: Path) -> tuple[SweepRecord, tuple[str, ...]]:
    """A sweep from its folder, and one line per damaged file.

    Raises RunError if it is not a sweep's folder, its sweep.json is damaged, or a newer karolos made it.
    """
    described = read_sweep_description(folder)
    found, problems = read_values(folder / TRIALS, lambda line: _trial(line, len(described.objectives)), "trial")
    trials = {trial.number: trial for trial in found}
    final = read_json(SweepFinal, folder / FINAL)
    if final is None and (folder / FINAL).exists():
        problems += (f"{FINAL} is damaged; left out",)
    record = replace(described, trials=tuple(trials[number] for number in sorted(trials)), final=final)
    return record, tuple(f"{folder.name}: {problem}" for problem in problems)


def _trial(line: bytes, objectives: int) -> Trial | None:
    """The trial in a line; None if it does not fit a sweep with this number of objectives."""
    trial = from_json(Trial, line)
    if trial is None or (trial.values is None) == (trial.state == "complete"):
        return None
    return trial if trial.values is None or len(trial.values) == objectives else None


def read_sweep_description(folder: Path) -> SweepRecord:
    """A sweep without its trials. Raises RunError as `read_sweep` does."""
    if not os.path.isfile(folder / DESCRIPTION):
        raise RunError("this is not a sweep's folder", where=str(folder))
    row = read_object(folder / DESCRIPTION) or {}
    if isinstance(row.get("format"), int) and row["format"] > FORMAT:
        raise RunError("a newer karolos made this sweep's folder", where=str(folder), hint="update karolos")
    record = from_json(SweepRecord, row | {"sweep": row.get("id"), "folder": str(folder.resolve())})
    if record is None or not ID.fullmatch(record.sweep) or not len(record.directions) == len(record.objectives) > 0:
        raise RunError(
            f"{DESCRIPTION} is damaged",
            where=str(folder),
            hint="remove that file: `karolos sweep SPEC` writes it again",
        )
    return record
