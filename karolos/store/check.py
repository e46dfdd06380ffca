"""Comparing the index with the folders of runs and sweeps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from itertools import islice
from pathlib import Path
from typing import Any

from sqlalchemy import text

from ..records.run_records import RunRecord
from ..records.sweep_records import FOLDER, is_running
from .folders import is_gone, read_folders, read_sweeps
from .rows import without_seeds
from .store import Store

_RUNS_PER_QUERY = 100
_GONE = "it is in the database, and its folder is gone"
_MISSING = "it has a folder, and is not in the database"


@dataclass(frozen=True)
class Difference:
    """A difference or damage of a run or a sweep, by its id; `run` is None for the database itself."""

    run: str | None
    what: str

    def row(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return asdict(self)


def check(store: Store, runs: str | Path, *, jobs: int = 1) -> Iterator[Difference]:
    """Compare the index with the folders in `runs`, run by run and sweep by sweep; nothing is changed.

    A run or sweep that a process is working on is skipped, because it changes meanwhile. `jobs` as in `reindex`.

    Raises:
        StoreError: the database cannot be read.
    """
    yield from _integrity(store)
    root = Path(runs).resolve()
    known: set[str] = set()
    folders = read_folders(root, jobs, locked=False)
    while group := list(islice(folders, _RUNS_PER_QUERY)):
        known.update(found.run for found in group if found.run is not None)
        yield from (Difference(found.run, problem) for found in group for problem in found.problems)
        yield from _runs(store, [found.record for found in group if found.record is not None])
    for run in store.runs():
        if run.run not in known and is_gone(run.folder, root):
            yield Difference(run.run, _GONE)
    yield from _sweeps(store, root)


def _runs(store: Store, expected: list[RunRecord]) -> Iterator[Difference]:
    found = store.records(store.runs(ids=[record.summary.run for record in expected]))
    stored = {record.summary.run: record for record in found}
    for record in expected:
        run = record.summary.run
        if (indexed := stored.get(run)) is None:
            yield Difference(run, _MISSING)
            continue
        row = indexed.summary.row()
        for name, value in record.summary.row().items():
            if row[name] != value:
                yield Difference(run, f"{name} is {value!r} in its folder and {row[name]!r} in the database")
        for what, recorded, entered in (
            ("tests", record.tests, indexed.tests),
            ("settings of its spec", without_seeds(record.spec), indexed.spec),
            ("versions of its software", record.versions, indexed.versions),
        ):
            if recorded != entered:
                yield Difference(run, f"the {what} differ in the database")


def _sweeps(store: Store, root: Path) -> Iterator[Difference]:
    records, problems = read_sweeps(root)
    yield from (Difference(None, f"a sweep's folder: {problem}") for problem in problems)
    stored = {record.sweep: record for record in store.sweeps.all()}
    for record in records:
        indexed = stored.get(record.sweep)
        if is_running(Path(record.folder)) or indexed == record:
            continue
        if indexed is None:
            yield Difference(record.sweep, _MISSING)
        else:
            names = [each.name for each in fields(record) if getattr(record, each.name) != getattr(indexed, each.name)]
            yield Difference(record.sweep, f"{', '.join(names)}: its folder and the database differ")
    read = {record.sweep for record in records}
    for one in stored.values():
        if one.sweep not in read and is_gone(one.folder, root / FOLDER):
            yield Difference(one.sweep, _GONE)


def _integrity(store: Store) -> Iterator[Difference]:
    if store.database.url.get_backend_name() != "sqlite":
        return  # a server checks itself
    problems = store.database.fetch(text("PRAGMA integrity_check(10)"))
    broken = store.database.fetch(text("PRAGMA foreign_key_check"))
    yield from (Difference(None, f"the database is damaged: {problem}") for (problem,) in problems if problem != "ok")
    yield from (Difference(None, f"a row of {row[0]} refers to a missing row of {row[2]}") for row in broken)
