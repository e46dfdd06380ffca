"""Reading a sweep's folder, which `karolos.sweep.folder` writes. Optuna and its journal are not needed for it."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

from ..errors import MachineError, RunError
from ..files import parse_object, read_lines
from .run_records import ID
from .sweep_records import FORMAT, Final, SweepRecord, Trial

FOLDER = "sweeps"
"""In the runs folder."""
DESCRIPTION, TRIALS, FINAL = "sweep.json", "trials.jsonl", "final.json"


def paths(runs: str | Path) -> list[Path]:
    """The folders of sweeps in a runs folder, sound or damaged, by name; other folders are passed over."""
    root = Path(runs) / FOLDER
    try:
        found = sorted(root.iterdir())
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        raise MachineError(f"cannot be read ({error.strerror})", where=str(root), hint="name a runs folder") from error
    return [path for path in found if os.path.isfile(path / DESCRIPTION)]


def read(folder: Path) -> tuple[SweepRecord, tuple[str, ...]]:
    """A sweep as its folder has it, and what is damaged in it, one line each.

    Raises:
        RunError: it is no sweep's folder, its sweep.json is damaged, or a newer karolos made it.
    """
    described = read_description(folder)
    lines = read_lines(folder / TRIALS)
    problems = list(lines.problems)
    trials = {trial.number: trial for row in lines.rows if (trial := _fitting(Trial.from_row(row), described))}
    if len(trials) < len(lines.rows):
        problems.append(f"{TRIALS}: {len(lines.rows) - len(trials)} lines hold no trial, or one again; left out")
    final = None
    if (folder / FINAL).exists():
        row = parse_object((folder / FINAL).read_bytes())
        final = None if row is None else Final.from_row(row)
        if final is None:
            problems.append(f"{FINAL} is damaged; left out")
    record = replace(described, trials=tuple(trials[number] for number in sorted(trials)), final=final)
    return record, tuple(f"{folder.name}: {problem}" for problem in problems)


def _fitting(trial: Trial | None, sweep: SweepRecord) -> Trial | None:
    """The trial, unless it cannot be one of the sweep's."""
    if trial is None or (trial.values is None) == (trial.state == "complete"):
        return None
    values = trial.values
    whole = values is None or (len(values) == len(sweep.objectives) and all(map(math.isfinite, values)))
    return trial if whole else None


def read_description(folder: Path) -> SweepRecord:
    """A sweep without its trials. Raises RunError as `read`."""
    try:
        row = parse_object((folder / DESCRIPTION).read_bytes())
    except OSError as error:
        raise RunError(f"this is no sweep's folder ({error.strerror})", where=str(folder)) from error
    if row is not None and isinstance(row.get("format"), int) and row["format"] > FORMAT:
        raise RunError("a newer karolos made this sweep's folder", where=str(folder), hint="update karolos")
    record = None if row is None else SweepRecord.from_description(row, folder.resolve())
    if record is None or not ID.fullmatch(record.sweep):
        raise RunError(
            f"{DESCRIPTION} is damaged",
            where=str(folder),
            hint="remove that file: `karolos sweep SPEC` writes it again",
        )
    return record
