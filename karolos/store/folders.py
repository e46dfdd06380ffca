"""Rebuilding the index from the run folders, which are the truth, and comparing it with them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from sqlalchemy import text

from ..errors import RunError, UsageError
from ..records import RunFolder, paths
from ..records.run_folder import remove_lost_leftovers
from ..records.run_records import RunRecord, without_seeds
from ..records.sweep_records import sweeps
from .database import RefusedValueError
from .store import Store

_RUNS_TOGETHER = 100
"""Number of runs per transaction or query."""


@dataclass(frozen=True)
class Reindexed:
    """Numbers of runs that were entered and forgotten (folder gone), and one line per damaged file."""

    runs: int
    forgotten: int
    problems: tuple[str, ...]


@dataclass(frozen=True)
class Difference:
    """A difference or damage of a run; `run` is None for the database itself, and for sweeps."""

    run: str | None
    what: str

    def row(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return asdict(self)


@dataclass(frozen=True)
class _FoundFolder:
    """A run folder; `run` and `record` are None if it is damaged, `record` also if it is locked."""

    name: str
    run: str | None
    record: RunRecord | None
    problems: tuple[str, ...]


def check_folder(runs: Path) -> None:
    """Raise UsageError if there is no such folder."""
    if not os.path.isdir(runs):
        what = f"{runs} is not a folder" if os.path.lexists(runs) else f"there is no folder {runs}"
        raise UsageError(what, hint="name the runs folder (--runs, in Python runs=)")


def open_index(runs: str | Path, database: str | None = None) -> tuple[Store | None, Reindexed | None]:
    """The index of a runs folder, or None if there are no runs. A missing one is rebuilt, with a report of that.

    `database` is its URL, by default that of the one in the runs folder.

    Raises UsageError if there is no such folder and it is not the default one, StoreError if the database cannot be
    read or written.
    """
    root = Path(runs)
    if database is None and (root != Path("runs") or root.exists()):
        check_folder(root)
    url = database or Store.default_url(root)
    if Store.exists(url):
        return Store(url), None
    if not any(root.glob("*/run.json")):
        return None, None
    store = Store(url)
    return store, reindex(store, root)


def reindex(store: Store, runs: str | Path) -> Reindexed:
    """Make the index agree with the folders in `runs`; runs in other folders stay as they are. Raises StoreError."""
    root = Path(runs).resolve()
    known: set[str] = set()
    problems: list[str] = []
    refused: list[str] = []
    remove_lost_leftovers(root)
    for group in _run_folders(root, locked=True):
        problems += (problem for found in group for problem in found.problems)
        known.update(found.run for found in group if found.run is not None)
        records = [found.record for found in group if found.record is not None]
        refused += _enter(store, records)
        # Enter runs again if they wrote into their folders and the database after these records were read.
        while records := [one for one in records if one.summary.state in ("created", "running")]:
            renewed = [_read(Path(one.summary.folder), locked=True).record or one for one in records]
            pairs = zip(renewed, records, strict=True)
            records = [new for new, old in pairs if (new.summary.state, new.tests) != (old.summary.state, old.tests)]
            _enter(store, records)  # it has refused the same values before
    gone = _gone(store, root, known)
    store.remove_runs(gone)
    return Reindexed(len(known) - len(refused), len(gone), (*problems, *refused, *sweeps(root)[1]))


def check(store: Store, runs: str | Path) -> Iterator[Difference]:
    """Compare the index with the folders in `runs`, run by run; nothing is changed. Damaged sweeps are named, too.

    A run that a process is working on is skipped, because it changes meanwhile. Raises StoreError.
    """
    if store.url.get_backend_name() == "sqlite":  # a server checks itself
        for (problem,) in store.fetch(text("PRAGMA integrity_check(10)")):
            if problem != "ok":
                yield Difference(None, f"the database is damaged: {problem}")
        for row in store.fetch(text("PRAGMA foreign_key_check")):
            yield Difference(None, f"a row of {row[0]} refers to a missing row of {row[2]}")
    root = Path(runs).resolve()
    known: set[str] = set()
    for group in _run_folders(root, locked=False):
        known.update(found.run for found in group if found.run is not None)
        yield from (Difference(found.run, problem) for found in group for problem in found.problems)
        recorded = {found.record.summary.run: _facts(found.record) for found in group if found.record is not None}
        entered = {one.summary.run: _facts(one) for one in store.records(store.runs(ids=list(recorded)))}
        for run, facts in recorded.items():
            yield from _differences(run, facts, entered.get(run))
    yield from (Difference(None, f"a sweep's folder: {problem}") for problem in sweeps(root)[1])
    yield from (Difference(run, "it is in the database, and its folder is gone") for run in _gone(store, root, known))


def _run_folders(root: Path, *, locked: bool) -> Iterator[list[_FoundFolder]]:
    """The run folders in a runs folder, by name and in groups. A second folder of the same run is a problem.

    If `locked`, also those of runs that a process is working on are read.
    """
    known: dict[str, str] = {}
    folders = (_read(path, locked) for path in paths(root))
    while group := list(islice(folders, _RUNS_TOGETHER)):
        for place, found in enumerate(group):
            if found.run is None:
                continue
            own = found.name
            if own != found.run and _names(root / found.run) == found.run:
                own = found.run  # a copy never replaces it
            other = known.setdefault(found.run, own)
            if other != found.name:
                problem = f"{found.name}: says that it is the run {found.run}, as {other} does; left out"
                problem += "; remove one of the two, or move it into another runs folder"
                group[place] = _FoundFolder(found.name, None, None, (problem,))
        yield group


def _names(path: Path) -> str | None:
    """The run that a folder says it is; None if it is no run folder."""
    try:
        return RunFolder.open(path).id
    except RunError:
        return None


def _read(path: Path, locked: bool) -> _FoundFolder:
    try:
        folder = RunFolder.open(path)
    except RunError as error:
        return _FoundFolder(path.name, None, None, (str(error),))
    if not locked and folder.is_locked():
        return _FoundFolder(path.name, folder.id, None, ())
    record = folder.record()
    return _FoundFolder(path.name, folder.id, record, tuple(f"{path.name}: {problem}" for problem in record.problems))


def _gone(store: Store, root: Path, known: set[str]) -> list[str]:
    """The runs of the index whose folders have disappeared from the runs folder."""
    lost = ((run.run, Path(run.folder)) for run in store.runs() if run.run not in known)
    return [run for run, folder in lost if folder.parent == root and not folder.exists()]


def _enter(store: Store, records: Sequence[RunRecord]) -> list[str]:
    """Enter runs together, or one by one if the database refuses a value; returns one line per refusal."""
    try:
        store.add_records(records)
    except RefusedValueError as error:
        if len(records) > 1:
            return [problem for record in records for problem in _enter(store, [record])]
        return [f"{Path(records[0].summary.folder).name}: {error.what}; left out"]
    return []


def _facts(record: RunRecord) -> dict[str, Any]:
    """The comparable values of a run in folder and index."""
    lists = {"settings of its spec": without_seeds(record.spec), "versions of its software": record.versions}
    return record.summary.row() | {"commit": record.commit, "tests": record.tests} | lists


def _differences(identity: str, recorded: Mapping[str, Any], entered: Mapping[str, Any] | None) -> Iterator[Difference]:
    """Differences of a run between its folder and the database."""
    if entered is None:
        yield Difference(identity, "it has a folder, and is not in the database")
        return
    for name, value in recorded.items():
        if entered[name] != value:
            what = f"{name} is {value!r} in its folder and {entered[name]!r} in the database"
            long = isinstance(value, tuple | Mapping)
            yield Difference(identity, f"the {name} differ in the database" if long else what)
