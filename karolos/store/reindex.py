"""Rebuilding the index from the run folders, which are the truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from .folders import read_folders
from .store import Store
from .writing import Entry

_RUNS_PER_TRANSACTION = 100


@dataclass(frozen=True)
class Reindexed:
    """Runs entered, runs forgotten because their folders are gone, and what is damaged, one line each."""

    runs: int
    forgotten: int
    problems: tuple[str, ...]


def reindex(store: Store, runs: str | Path, *, jobs: int = 1) -> Reindexed:
    """Make the index agree with the folders in `runs`; runs that lie elsewhere stay as they are.

    Args:
        store: the index.
        runs: the runs folder.
        jobs: processes that read the folders; a script that asks for several guards its start by `__name__`.

    Raises:
        StoreError: the database cannot be written.
    """
    root = Path(runs).resolve()
    known: dict[str, str] = {}
    problems: list[str] = []
    waiting: list[Entry] = []
    for found in read_folders(root, jobs):
        problems += found.problems
        if found.run is None or found.entry is None:
            continue
        if found.run in known:
            problems.append(f"{found.name}: says that it is the run {found.run}, as {known[found.run]} does; left out")
            continue
        known[found.run] = found.name
        waiting.append(found.entry)
        if len(waiting) == _RUNS_PER_TRANSACTION:
            store.add_entries(waiting)
            waiting.clear()
    if waiting:
        store.add_entries(waiting)
    gone = [
        run.run
        for run in store.runs()
        if run.run not in known and Path(run.folder).parent == root and not Path(run.folder).exists()
    ]
    store.remove_runs(gone)
    return Reindexed(len(known), len(gone), tuple(problems))
