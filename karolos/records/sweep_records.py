"""What is known of a sweep, as frozen values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from ..files import FileLock

FORMAT = 1
"""Version of the folder's layout, in sweep.json."""
LOCK = "lock"
"""The file that the process holds which carries a sweep out."""
State = Literal["running", "complete", "pruned", "failed"]


@dataclass(frozen=True)
class Trial:
    """One trial: what was drawn, and what came of it."""

    number: int
    """From 0."""
    name: str
    """Of its runs."""
    state: State
    """Running until it has come to an end, even while an interrupted sweep rests."""
    drawn: Mapping[str, Any]
    """Parameter -> number, or label of a choice; parameters whose condition did not hold are missing."""
    values: tuple[float, ...] | None
    """One for each objective; None unless complete."""
    runs: tuple[str, ...]
    """Ids of its runs, in the order of the seeds; known from its end on."""
    error: str | None

    def row(self) -> dict[str, Any]:
        """As JSON values."""
        return asdict(self) | {"values": self.values and list(self.values), "runs": list(self.runs)}

    @classmethod
    def from_row(cls, row: Mapping[str, Any]) -> Trial | None:
        """The trial that a JSON object holds, or None when it holds none."""
        try:
            values = None if row["values"] is None else tuple(map(float, row["values"]))
            error = None if row["error"] is None else str(row["error"])
            runs = tuple(map(str, row["runs"]))
            trial = cls(int(row["number"]), str(row["name"]), row["state"], dict(row["drawn"]), values, runs, error)
        except (KeyError, TypeError, ValueError):
            return None
        return trial if trial.state in get_args(State) else None


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
        return {
            "chosen": self.chosen,
            "seeds": list(self.seeds),
            "report_seeds": list(self.report_seeds),
            "tuned": list(self.tuned),
            "fresh": {str(number): list(values) for number, values in self.fresh.items()},
            "reported": None if self.reported is None else list(self.reported),
            "gap": gap,
        }

    @classmethod
    def from_row(cls, row: Mapping[str, Any]) -> Final | None:
        """What a JSON object holds, or None when it holds nothing of the kind."""
        try:
            return cls(
                int(row["chosen"]),
                tuple(map(int, row["seeds"])),
                tuple(map(int, row["report_seeds"])),
                tuple(map(float, row["tuned"])),
                {int(number): tuple(map(float, values)) for number, values in row["fresh"].items()},
                None if row["reported"] is None else tuple(map(float, row["reported"])),
            )
        except (AttributeError, KeyError, TypeError, ValueError):
            return None


@dataclass(frozen=True)
class SweepRecord:
    """A search over a spec's settings, and its trials so far."""

    sweep: str
    """Id: its name and the time at which it began."""
    name: str
    experiment: str
    """Hash of the spec whose settings are searched."""
    objectives: tuple[str, ...]
    """What trials are judged by, the most important first."""
    directions: tuple[str, ...]
    """maximize or minimize, one for each objective."""
    parameters: tuple[str, ...]
    """Key paths of the settings that are searched."""
    seeds: tuple[int, ...]
    """Of every trial."""
    asked: int
    """How many trials it is to have."""
    wants_final: bool
    """Whether the best trials are to be run on fresh seeds."""
    created: str
    """ISO 8601, UTC."""
    folder: str
    trials: tuple[Trial, ...] = ()
    """By number."""
    final: Final | None = None

    @property
    def ended(self) -> int:
        """How many trials have come to an end."""
        return sum(trial.state != "running" for trial in self.trials)

    @property
    def ranked(self) -> list[Trial]:
        """The complete trials, best first: by the first objective, then the next; of equals the earlier."""
        return rank(self.trials, self.directions)

    @property
    def best(self) -> Trial | None:
        """The trial that `final` chose; without it, the first of `ranked`."""
        if self.final is not None:
            return next((trial for trial in self.trials if trial.number == self.final.chosen), None)
        return next(iter(self.ranked), None)

    def state(self) -> str:
        """As it is now: running; finished; or stopped, when trials are missing and no process carries it out."""
        if is_running(Path(self.folder)):
            return "running"
        missing = self.ended < self.asked or (self.wants_final and self.final is None and bool(self.ranked))
        return "stopped" if missing else "finished"

    def description(self) -> dict[str, Any]:
        """What stands in sweep.json."""
        names = ("name", "experiment", "created", "asked", "wants_final")
        lists = ("objectives", "directions", "parameters", "seeds")
        texts = {name: getattr(self, name) for name in names} | {name: list(getattr(self, name)) for name in lists}
        return {"format": FORMAT, "id": self.sweep, **texts}

    @classmethod
    def from_description(cls, row: Mapping[str, Any], folder: Path) -> SweepRecord | None:
        """The sweep, without trials, that a JSON object describes; None when it describes none."""
        try:
            record = cls(
                sweep=str(row["id"]),
                name=str(row["name"]),
                experiment=str(row["experiment"]),
                objectives=tuple(map(str, row["objectives"])),
                directions=tuple(map(str, row["directions"])),
                parameters=tuple(map(str, row["parameters"])),
                seeds=tuple(map(int, row["seeds"])),
                asked=int(row["asked"]),
                wants_final=bool(row["wants_final"]),
                created=str(row["created"]),
                folder=str(folder),
            )
        except (KeyError, TypeError, ValueError):
            return None
        return record if len(record.directions) == len(record.objectives) > 0 else None

    def row(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "sweep": self.sweep,
            "state": self.state(),
            **{key: value for key, value in self.description().items() if key not in {"id", "format"}},
            "folder": self.folder,
            "best": self.best.number if self.best else None,
            "final": self.final.row() if self.final else None,
            "trials": [trial.row() for trial in self.trials],
        }


def merit(values: Sequence[float], directions: Sequence[str]) -> tuple[float, ...]:
    """Objectives so turned that smaller is better."""
    return tuple(-value if way == "maximize" else value for value, way in zip(values, directions, strict=True))


def rank(trials: Sequence[Trial], directions: Sequence[str]) -> list[Trial]:
    """The complete ones of some trials, best first: by the first objective, then the next; of equals the earlier."""
    complete = [(merit(trial.values, directions), trial.number, trial) for trial in trials if trial.values is not None]
    return [trial for *_, trial in sorted(complete, key=lambda each: each[:2])]


def is_running(folder: Path) -> bool:
    """Whether a process carries out the sweep in this folder."""
    return FileLock(folder / LOCK).is_locked()
