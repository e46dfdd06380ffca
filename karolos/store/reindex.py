"""Rebuilding the index from the folders of runs and sweeps, which are the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from ..records.run_folder import remove_lost_leftovers
from ..records.run_records import RunRecord
from ..records.sweep_records import FOLDER, SweepRecord
from .database import RefusedValueError
from .folders import is_gone, read_folders, read_sweeps
from .store import Store

_RUNS_PER_TRANSACTION = 100
_Record = TypeVar("_Record", RunRecord, SweepRecord)


@dataclass(frozen=True)
class Reindexed:
    """Numbers of runs and sweeps that were entered and forgotten (folder gone), and one line per damaged file."""

    runs: int
    forgotten: int
    problems: tuple[str, ...]
    sweeps: int
    forgotten_sweeps: int


def reindex(store: Store, runs: str | Path, *, jobs: int = 1) -> Reindexed:
    """Make the index agree with the folders in `runs`; runs in other folders stay as they are.

    Args:
        store: the index.
        runs: the runs folder.
        jobs: processes that read the folders; a script that uses several guards its start by `__name__`.

    Raises:
        StoreError: the database cannot be written.
    """
    root = Path(runs).resolve()
    known: set[str] = set()
    problems: list[str] = []
    refused: list[str] = []
    waiting: list[RunRecord] = []
    remove_lost_leftovers(root)
    for found in read_folders(root, jobs):
        problems += found.problems
        if found.record is not None:
            known.add(found.record.summary.run)
            waiting.append(found.record)
        if len(waiting) == _RUNS_PER_TRANSACTION:
            refused += _enter(store.add_records, waiting)
            waiting.clear()
    refused += _enter(store.add_records, waiting)
    gone = [run.run for run in store.runs() if run.run not in known and is_gone(run.folder, root)]
    store.remove_runs(gone)
    sweeps, damaged = read_sweeps(root)
    refused_sweeps = _enter(store.sweeps.add, sweeps)
    read = {record.sweep for record in sweeps}
    lost = [one.sweep for one in store.sweeps.all() if one.sweep not in read and is_gone(one.folder, root / FOLDER)]
    store.sweeps.remove(lost)
    return Reindexed(
        runs=len(known) - len(refused),
        forgotten=len(gone),
        problems=(*problems, *refused, *damaged, *refused_sweeps),
        sweeps=len(sweeps) - len(refused_sweeps),
        forgotten_sweeps=len(lost),
    )


def _enter(add: Callable[[Sequence[_Record]], None], records: Sequence[_Record]) -> list[str]:
    """Enter runs or sweeps together, or one by one if the database refuses a value; returns one line per refusal."""
    try:
        add(records)
    except RefusedValueError as error:
        if len(records) > 1:
            return [problem for record in records for problem in _enter(add, [record])]
        folder = records[0].summary.folder if isinstance(records[0], RunRecord) else records[0].folder
        return [f"{Path(folder).name}: {error.what}; left out"]
    return []
