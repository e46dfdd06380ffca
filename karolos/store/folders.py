"""Rebuilding the index from the folders of runs and sweeps, which are the truth, and comparing it with them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from sqlalchemy import text

from ..errors import RunError, UsageError
from ..records import RunFolder, paths
from ..records.run_folder import remove_lost_leftovers
from ..records.run_records import RunRecord
from ..records.sweep_records import FOLDER, SweepRecord, is_running, read_sweep, sweep_paths
from .database import RefusedValueError
from .rows import without_seeds
from .store import Store

_RUNS_TOGETHER = 100
"""Runs of a transaction or a query."""
_Record = TypeVar("_Record", RunRecord, SweepRecord)


@dataclass(frozen=True)
class Reindexed:
    """Numbers of runs and sweeps that were entered and forgotten (folder gone), and one line per damaged file."""

    runs: int
    forgotten: int
    problems: tuple[str, ...]
    sweeps: int
    forgotten_sweeps: int


@dataclass(frozen=True)
class Difference:
    """A difference or damage of a run or a sweep, by its id; `run` is None for the database itself."""

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


def open_index(runs: str | Path, database: str | None = None) -> tuple[Store | None, Reindexed | None]:
    """The index of a runs folder, or None if there are no runs. A missing one is rebuilt, and what was entered is told.

    Args:
        runs: the runs folder.
        database: URL of the database; by default the one in the runs folder.

    Raises:
        UsageError: there is no such folder, and it is not the default one.
        StoreError: the database cannot be read or written.
    """
    root = Path(runs)
    if not os.path.isdir(root) and database is None and root != Path("runs"):
        raise UsageError(f"there is no folder {runs}", hint="name the runs folder (--runs, in Python runs=)")
    url = database or Store.default_url(root)
    if Store.exists(url):
        return Store(url), None
    if not any(root.glob("*/run.json")) and not any(root.glob("sweeps/*/sweep.json")):
        return None, None
    store = Store(url)
    return store, reindex(store, root)


def reindex(store: Store, runs: str | Path) -> Reindexed:
    """Make the index agree with the folders in `runs`; runs in other folders stay as they are.

    Raises:
        StoreError: the database cannot be written.
    """
    root = Path(runs).resolve()
    known: set[str] = set()
    problems: list[str] = []
    refused: list[str] = []
    remove_lost_leftovers(root)
    for group in _run_folders(root, locked=True):
        problems += (problem for found in group for problem in found.problems)
        known.update(found.run for found in group if found.run is not None)
        records = [found.record for found in group if found.record is not None]
        refused += _enter(store.add_records, records)
        _catch_up(store, records)
    gone = _gone_runs(store, root, known)
    store.remove_runs(gone)
    sweeps, damaged = _read_sweeps(root)
    refused_sweeps = _enter(store.sweeps.add, sweeps)
    lost = _gone_sweeps(store, root, sweeps)
    store.sweeps.remove(lost)
    return Reindexed(
        runs=len(known) - len(refused),
        forgotten=len(gone),
        problems=(*problems, *refused, *damaged, *refused_sweeps),
        sweeps=len(sweeps) - len(refused_sweeps),
        forgotten_sweeps=len(lost),
    )


def check(store: Store, runs: str | Path) -> Iterator[Difference]:
    """Compare the index with the folders in `runs`, run by run and sweep by sweep; nothing is changed.

    A run or sweep that a process is working on is skipped, because it changes meanwhile.

    Raises:
        StoreError: the database cannot be read.
    """
    yield from _integrity(store)
    root = Path(runs).resolve()
    known: set[str] = set()
    for group in _run_folders(root, locked=False):
        known.update(found.run for found in group if found.run is not None)
        yield from (Difference(found.run, problem) for found in group for problem in found.problems)
        recorded = {found.record.summary.run: _facts(found.record) for found in group if found.record is not None}
        entered = {one.summary.run: _facts(one) for one in store.records(store.runs(ids=list(recorded)))}
        for run, facts in recorded.items():
            yield from _differences(run, facts, entered.get(run))
    sweeps, problems = _read_sweeps(root)
    stored = {record.sweep: vars(record) for record in store.sweeps.all()}
    yield from (Difference(None, f"a sweep's folder: {problem}") for problem in problems)
    for record in sweeps:
        if not is_running(Path(record.folder)):
            yield from _differences(record.sweep, vars(record), stored.get(record.sweep))
    for gone in (*_gone_runs(store, root, known), *_gone_sweeps(store, root, sweeps)):
        yield Difference(gone, "it is in the database, and its folder is gone")


def _run_folders(root: Path, *, locked: bool) -> Iterator[list[_FoundFolder]]:
    """The run folders in a runs folder, by name and in groups; of two of one run, the second is named as a problem.

    Args:
        root: the runs folder.
        locked: also read folders of runs that a process is working on.
    """
    known: dict[str, str] = {}
    folders = (_read(path, locked) for path in paths(root))
    while group := list(islice(folders, _RUNS_TOGETHER)):
        for place, found in enumerate(group):
            other = found.name if found.run is None else known.setdefault(found.run, found.name)
            if other != found.name:
                problem = f"{found.name}: says that it is the run {found.run}, as {other} does; left out"
                group[place] = _FoundFolder(found.name, None, None, (problem,))
        yield group


def _read(path: Path, locked: bool) -> _FoundFolder:
    try:
        folder = RunFolder.open(path)
    except RunError as error:
        return _FoundFolder(path.name, None, None, (str(error),))
    if not locked and folder.is_locked():
        return _FoundFolder(path.name, folder.id, None, ())
    record = folder.record()
    return _FoundFolder(path.name, folder.id, record, tuple(f"{path.name}: {problem}" for problem in record.problems))


def _read_sweeps(root: Path) -> tuple[tuple[SweepRecord, ...], tuple[str, ...]]:
    """The sweeps in a runs folder by folder name, each once, and one line per damaged file."""
    found: dict[str, SweepRecord] = {}
    problems: list[str] = []
    for path in sweep_paths(root):
        try:
            record, damaged = read_sweep(path)
        except RunError as error:
            problems.append(str(error))
            continue
        problems += damaged
        known = found.setdefault(record.sweep, record)
        if known is not record:
            other = Path(known.folder).name
            problems.append(f"{path.name}: says that it is the sweep {record.sweep}, as {other} does; left out")
    return tuple(found.values()), tuple(problems)


def _gone_runs(store: Store, root: Path, known: set[str]) -> list[str]:
    """The runs of the index that were in the runs folder and are no longer there."""
    return [run.run for run in store.runs() if run.run not in known and _is_gone(run.folder, root)]


def _gone_sweeps(store: Store, root: Path, sweeps: Sequence[SweepRecord]) -> list[str]:
    known = {record.sweep for record in sweeps}
    return [one.sweep for one in store.sweeps.all() if one.sweep not in known and _is_gone(one.folder, root / FOLDER)]


def _is_gone(folder: str, home: Path) -> bool:
    """Whether a folder that stood in `home` does not exist any more."""
    path = Path(folder)
    return path.parent == home and not path.exists()


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


def _catch_up(store: Store, records: Sequence[RunRecord]) -> None:
    """Enter runs again that wrote into their folders, and the database, after these records of them were read."""
    while records := [one for one in records if one.summary.state in ("created", "running")]:
        renewed = [_read(Path(one.summary.folder), locked=True).record or one for one in records]
        records = [
            new
            for new, old in zip(renewed, records, strict=True)
            if (new.summary.state, new.tests) != (old.summary.state, old.tests)
        ]
        _enter(store.add_records, records)  # what it refuses now it has refused before


def _facts(record: RunRecord) -> dict[str, Any]:
    """What folder and index have of a run."""
    lists = {"settings of its spec": without_seeds(record.spec), "versions of its software": record.versions}
    return record.summary.row() | {"tests": record.tests} | lists


def _differences(identity: str, recorded: Mapping[str, Any], entered: Mapping[str, Any] | None) -> Iterator[Difference]:
    """How a run or a sweep in its folder differs from that in the database."""
    if entered is None:
        yield Difference(identity, "it has a folder, and is not in the database")
        return
    for name, value in recorded.items():
        if entered[name] != value:
            what = f"{name} is {value!r} in its folder and {entered[name]!r} in the database"
            long = isinstance(value, tuple | Mapping)
            yield Difference(identity, f"the {name} differ in the database" if long else what)


def _integrity(store: Store) -> Iterator[Difference]:
    if store.database.url.get_backend_name() != "sqlite":
        return  # a server checks itself
    problems = store.database.fetch(text("PRAGMA integrity_check(10)"))
    broken = store.database.fetch(text("PRAGMA foreign_key_check"))
    yield from (Difference(None, f"the database is damaged: {problem}") for (problem,) in problems if problem != "ok")
    yield from (Difference(None, f"a row of {row[0]} refers to a missing row of {row[2]}") for row in broken)
