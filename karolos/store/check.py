"""Comparing the index with the folders of runs and sweeps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from sqlalchemy import select, text

from ..records.run_records import RunSummary, flatten
from ..records.sweep_records import FOLDER, is_running
from .folders import is_gone, read_folders, read_sweeps
from .store import Store
from .tables import RUNS
from .writing import RunEntry

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
    comparison = _RunComparison(store)
    known: set[str] = set()
    waiting: list[RunEntry] = []
    for found in read_folders(root, jobs, locked=False):
        yield from (Difference(found.run, problem) for problem in found.problems)
        if found.run is None:
            continue
        if found.run in known:
            yield Difference(found.run, f"two folders say that they are this run, one is {found.name}")
            continue
        known.add(found.run)
        if found.entry is None:
            continue
        waiting.append(found.entry)
        if len(waiting) == _RUNS_PER_QUERY:
            yield from comparison.differences(waiting)
            waiting.clear()
    yield from comparison.differences(waiting)
    for run in store.runs():
        if run.run not in known and is_gone(run.folder, root):
            yield Difference(run.run, _GONE)
    yield from _sweeps(store, root)


def _sweeps(store: Store, root: Path) -> Iterator[Difference]:
    records, problems = read_sweeps(root)
    yield from (Difference(None, f"a sweep's folder: {problem}") for problem in problems)
    stored = {record.sweep: record for record in store.sweeps.all()}
    for record in records:
        if is_running(Path(record.folder)):
            continue
        indexed = stored.get(record.sweep)
        if indexed is None:
            yield Difference(record.sweep, _MISSING)
        elif indexed != record:
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


class _RunComparison:
    """Compares runs in groups; rows that runs share are compared once."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._equal: dict[str, bool] = {}

    def differences(self, entries: Sequence[RunEntry]) -> Iterator[Difference]:
        names = [entry.summary.run for entry in entries]
        stored = {run.run: run for run in self._store.runs(ids=names)}
        tests = self._store.tests_of(names)
        rows = self._store.database.fetch(select(RUNS.c.run, RUNS.c.spec, RUNS.c.software).where(RUNS.c.run.in_(names)))
        shared = {row.run: row for row in rows}
        for entry in entries:
            run = entry.summary.run
            if run not in stored or run not in shared:
                yield Difference(run, _MISSING)
                continue
            yield from _fields(entry.summary, stored[run])
            expected = tuple(entry.tests or ())
            if tests[run] != expected:
                what = f"its folder has {len(expected)} tests, the database has {len(tests[run])} or other tests"
                yield Difference(run, what)
            spec = dict(flatten(entry.spec))
            if shared[run].spec != entry.spec_digest or not self._equals(entry.spec_digest, spec, run):
                yield Difference(run, "the settings of its spec differ in the database")
            software, versions = entry.software, entry.versions or {}
            if shared[run].software != software or not self._equals(str(software), versions, run):
                yield Difference(run, "the versions of its software differ in the database")

    def _equals(self, name: str, expected: Mapping[str, Any], run: str) -> bool:
        """Whether the database stores these settings or versions under a digest."""
        if name not in self._equal:
            self._equal[name] = expected in (self._store.parameters(run), self._store.versions(run))
        return self._equal[name]


def _fields(expected: RunSummary, stored: RunSummary) -> Iterator[Difference]:
    indexed = stored.row()
    for name, value in expected.row().items():
        if indexed[name] != value:
            yield Difference(expected.run, f"{name} is {value!r} in its folder and {indexed[name]!r} in the database")
