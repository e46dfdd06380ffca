"""Rebuilding the index from the run folders, which are the truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..errors import RunError
from ..run_folder import scan
from ..run_records import RunRecord
from .store import Store

_RUNS_PER_TRANSACTION = 100


@dataclass(frozen=True)
class Reindexed:
    """Runs entered, runs forgotten because their folders are gone, and what is damaged, one line each."""

    runs: int
    forgotten: int
    problems: tuple[str, ...]


def reindex(store: Store, runs: str | Path) -> Reindexed:
    """Make the index agree with the folders in `runs`; runs that lie elsewhere stay as they are.

    Raises:
        StoreError: the database cannot be written.
    """
    root = Path(runs).resolve()
    known: set[str] = set()
    problems: list[str] = []
    waiting: list[RunRecord] = []
    for found in scan(root):
        if isinstance(found, RunError):
            problems.append(str(found))
            continue
        record = found.record()
        problems += [f"{found.path.name}: {problem}" for problem in record.problems]
        known.add(found.id)
        waiting.append(record)
        if len(waiting) == _RUNS_PER_TRANSACTION:
            store.add_records(waiting)
            waiting.clear()
    store.add_records(waiting)
    gone = [
        run.run
        for run in store.runs()
        if run.run not in known and Path(run.folder).parent == root and not Path(run.folder).exists()
    ]
    store.remove_runs(gone)
    return Reindexed(len(known), len(gone), tuple(problems))
