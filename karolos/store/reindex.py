"""Rebuilding the index from the folders of runs and sweeps, which are the truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..records.run_folder import remove_lost_leftovers
from ..records.sweep_records import FOLDER
from .folders import is_gone, read_folders, read_sweeps
from .store import Store
from .writing import RunEntry

_RUNS_PER_TRANSACTION = 100


@dataclass(frozen=True)
class Reindexed:
    """Numbers of runs and sweeps that were entered and forgotten (folder gone), and one line per damaged file."""

    runs: int
    forgotten: int
    problems: tuple[str, ...]
    sweeps: int = 0
    forgotten_sweeps: int = 0


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
    known: dict[str, str] = {}
    problems: list[str] = []
    waiting: list[RunEntry] = []
    remove_lost_leftovers(root)
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
    gone = [run.run for run in store.runs() if run.run not in known and is_gone(run.folder, root)]
    store.remove_runs(gone)
    sweeps, damaged = read_sweeps(root)
    store.sweeps.add(sweeps)
    read = {record.sweep for record in sweeps}
    lost = [one.sweep for one in store.sweeps.all() if one.sweep not in read and is_gone(one.folder, root / FOLDER)]
    store.sweeps.remove(lost)
    return Reindexed(len(known), len(gone), (*problems, *damaged), len(sweeps), len(lost))
