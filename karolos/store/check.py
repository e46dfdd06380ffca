"""Whether the index says what the folders of runs and sweeps say."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from sqlalchemy import select, text

from ..records.run_records import RunSummary, flatten
from ..records.sweep_reading import FOLDER
from ..records.sweep_records import is_running
from .folders import is_gone, read_folders, read_sweeps
from .rows import digest, without_seeds
from .store import Store
from .tables import RUNS
from .writing import Entry

_RUNS_AT_ONCE = 100
_GONE = "it is in the database, and its folder is gone"


@dataclass(frozen=True)
class Difference:
    """Something that is not as it should be with a run or a sweep, by its id; `run` None: with the database itself."""

    run: str | None
    what: str

    def row(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return asdict(self)


def check(store: Store, runs: str | Path, *, jobs: int = 1) -> Iterator[Difference]:
    """Compare the index with the folders in `runs`, run by run and sweep by sweep; nothing is changed.

    What a process is working on is passed over: it changes while one looks. `jobs` as in `reindex`.

    Raises:
        StoreError: the database cannot be read.
    """
    yield from _integrity(store)
    root = Path(runs).resolve()
    comparison = _Comparison(store)
    known: set[str] = set()
    waiting: list[Entry] = []
    for found in read_folders(root, jobs, living=False):
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
        if len(waiting) == _RUNS_AT_ONCE:
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
            yield Difference(record.sweep, "it has a folder, and is not in the database")
        elif indexed != record:
            names = [each.name for each in fields(record) if getattr(record, each.name) != getattr(indexed, each.name)]
            yield Difference(record.sweep, f"{', '.join(names)}: its folder and the database differ")
    there = {record.sweep for record in records}
    for one in stored.values():
        if one.sweep not in there and is_gone(one.folder, root / FOLDER):
            yield Difference(one.sweep, _GONE)


def _integrity(store: Store) -> Iterator[Difference]:
    if store.url.get_backend_name() != "sqlite":
        return  # servers look after themselves
    with store.reading() as connection:
        problems = connection.execute(text("PRAGMA integrity_check(10)")).scalars().all()
        broken = connection.execute(text("PRAGMA foreign_key_check")).all()
    yield from (Difference(None, f"the database is damaged: {problem}") for problem in problems if problem != "ok")
    yield from (Difference(None, f"a row of {row[0]} refers to one of {row[2]} that is not there") for row in broken)


class _Comparison:
    """Compares portions of runs; what runs share is looked at once."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._sound: dict[str, bool] = {}

    def differences(self, entries: Sequence[Entry]) -> Iterator[Difference]:
        names = [entry.summary.run for entry in entries]
        stored = {run.run: run for run in self._store.runs(ids=names)}
        tests = self._store.tests_of(names)
        with self._store.reading() as connection:
            query = select(RUNS.c.run, RUNS.c.spec, RUNS.c.software).where(RUNS.c.run.in_(names))
            shared = {row.run: row for row in connection.execute(query)}
        for entry in entries:
            run = entry.summary.run
            if run not in stored or run not in shared:
                yield Difference(run, "it has a folder, and is not in the database")
                continue
            yield from _fields(entry.summary, stored[run])
            expected = entry.tests or ()
            if tests[run] != tuple(expected):
                what = f"its folder has {len(expected)} tests, the database {len(tests[run])} or others"
                yield Difference(run, what)
            spec = without_seeds(entry.spec)
            if shared[run].spec != digest(spec) or not self._agrees(digest(spec), dict(flatten(spec)), run):
                yield Difference(run, "the settings of its spec are others in the database")
            software = digest(entry.versions) if entry.versions else None
            if shared[run].software != software or not self._agrees(str(software), entry.versions or {}, run):
                yield Difference(run, "the versions of its software are others in the database")

    def _agrees(self, name: str, truth: Mapping[str, Any], run: str) -> bool:
        """Whether the settings or versions that the database keeps under a digest are those."""
        if name not in self._sound:
            self._sound[name] = truth in (self._store.parameters(run), self._store.versions(run))
        return self._sound[name]


def _fields(truth: RunSummary, stored: RunSummary) -> Iterator[Difference]:
    before, now = truth.row(), stored.row()
    for name, value in before.items():
        if now[name] != value:
            yield Difference(truth.run, f"{name} is {value!r} in its folder and {now[name]!r} in the database")
