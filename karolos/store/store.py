"""Store: the index over all runs. The run folders are the truth; `reindex` rebuilds it from them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

from sqlalchemy import Connection, Executable, delete, func, select, update

from ..errors import StoreError, UsageError
from ..records import RunFolder
from ..records.results import TestResult
from ..records.run_records import STATES, RunRecord, RunSummary
from . import filters, selectors, writing
from .connection import READ, display, explained, lock_writers, make_engine, parse_url, sqlite_file
from .reading import Index, stored_parameters
from .rows import StoredTest, chunks, run_row, upsert
from .schema import ensure_schema
from .sweeps import Sweeps
from .tables import PARAMETERS, RUNS, SPECS, SUCCESSES, TESTS, VERSIONS
from .writing import Entry

BUSY_SECONDS = 20.0
"""How long a transaction waits for another process's; whoever writes holds the lock for milliseconds."""
FILE_NAME = "karolos.sqlite"


class Store:
    """The results database. Safe for many processes at once; give each its own Store.

    Args:
        url: SQLAlchemy URL, e.g. sqlite:///runs/karolos.sqlite, or postgresql://host/name with the extra `postgres`.
            A SQLite file that is not there is made.
        timeout: seconds a transaction that writes waits for other processes.

    Attributes:
        home: folder of a SQLite database, None for any other.
        sweeps: the searches over specs, and their trials.

    Raises:
        StoreError: from every method, when the database is locked, read-only, damaged, newer or not ours.
    """

    def __init__(self, url: str, *, timeout: float = BUSY_SECONDS) -> None:
        self.url = parse_url(url)
        path = sqlite_file(self.url)
        self.home = path.resolve().parent if path else None
        self.sweeps = Sweeps(self)
        self._timeout = timeout
        self._engine = make_engine(self.url, timeout)
        self._readers = self._engine.execution_options(**{READ: True})
        ensure_schema(self._engine, self.url, timeout)

    @staticmethod
    def default_url(runs: str | Path) -> str:
        """URL of the database that lies in a runs folder."""
        return f"sqlite:///{Path(runs) / FILE_NAME}"

    @staticmethod
    def exists(url: str) -> bool:
        """Whether there is a database to open; of anything but SQLite that is taken for granted."""
        path = sqlite_file(parse_url(url))
        return path is None or os.path.exists(path)

    def close(self) -> None:
        """Close every connection. Safe to call twice."""
        self._engine.dispose()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def add_run(self, summary: RunSummary, spec: Mapping[str, Any], versions: Mapping[str, str] | None = None) -> None:
        """Enter a run, or replace its row; its tests stay.

        Args:
            summary: of the run.
            spec: resolved.
            versions: of the software that it is made with (`RunFolder.versions`).
        """
        with self.writing() as connection:
            writing.enter(connection, [Entry(summary, spec, versions, None)], self.home)

    def add_records(self, records: Sequence[RunRecord]) -> None:
        """Enter runs with all their tests, in place of those stored, in one transaction."""
        self.add_entries([Entry.of(record) for record in records])

    def add_entries(self, entries: Sequence[Entry]) -> None:
        """Enter runs in place of those stored, in one transaction."""
        with self.writing() as connection:
            writing.enter(connection, entries, self.home)

    def update_run(self, summary: RunSummary) -> None:
        """Bring a run's row up to date, but for its labels (`refresh_labels`).

        Raises:
            StoreError: the run is not there.
        """
        row = run_row(summary, self.home)
        with self.writing() as connection:
            changed = connection.execute(update(RUNS).where(RUNS.c.run == summary.run).values(**row))
            if changed.rowcount == 0:
                raise self._unknown(summary.run)

    def refresh_labels(self, folder: RunFolder) -> None:
        """Read a run's tags and note out of its folder, where they were changed.

        Raises:
            StoreError: the run is not there.
        """
        with self.writing() as connection:
            if not writing.refresh_labels(connection, folder.id, folder.path):
                raise self._unknown(folder.id)

    def add_test(self, run: str, result: TestResult) -> None:
        """Enter a test of a run; one at the same steps, which a resumed run repeats, is replaced."""
        experiment = select(RUNS.c.experiment).where(RUNS.c.run == run).scalar_subquery()
        with self.writing() as connection:
            upsert(connection, TESTS, [StoredTest.of(run, result).to_row()], keys=("run", "steps"))
            connection.execute(delete(SUCCESSES).where(SUCCESSES.c.experiment == experiment))

    def remove_runs(self, runs: Sequence[str]) -> None:
        """Take runs out of the index, with their tests and what no other run shares; folders stay."""
        with self.writing() as connection:
            writing.remove(connection, runs)

    def runs(
        self,
        *,
        ids: Sequence[str] | None = None,
        prefix: str | None = None,
        experiment: str | None = None,
        name: str | None = None,
        state: str | None = None,
        where: str | None = None,
        limit: int | None = None,
    ) -> tuple[RunSummary, ...]:
        """Runs, the newest first.

        Where the index says that a run goes on and no process does it, its folder tells what became of it (`lost`, or
        an end that was not indexed any more).

        Args:
            ids: only these.
            prefix: only runs whose id begins so.
            experiment: only runs whose experiment's hash begins so.
            name: only runs of experiments that are called so.
            state: only runs in this state, which may be `lost`.
            where: a filter (`karolos.filters`) over the fields of RunSummary, the settings of the spec by their key
                paths (agent.learning_rate), and versions.<package>.
            limit: not more than that many.

        Raises:
            UsageError: there is no such state, or the filter cannot be read or names what no run has.
        """
        if state is not None and state not in STATES:
            raise UsageError(f"there is no state {state!r}", hint=f"there are {', '.join(STATES)}")
        condition = filters.parse(where) if where is not None else None
        query = select(RUNS).order_by(RUNS.c.created.desc(), RUNS.c.run.desc())
        for column, beginning in ((RUNS.c.run, prefix), (RUNS.c.experiment, experiment)):
            if beginning is not None:
                query = query.where(func.substr(column, 1, len(beginning)) == beginning)  # LIKE may ignore case
        if name is not None:
            query = query.where(RUNS.c.name == name)
        if ids is not None:
            query = query.where(RUNS.c.run.in_(ids))
        with self.reading() as connection:
            return Index(connection, self.home).find(query, state, condition, limit)

    def find(self, selector: str) -> RunSummary:
        """The one run that a selector means (`selectors.select`).

        Raises:
            UsageError: it means no run, or several; names some.
        """
        return selectors.only(selector, selectors.select(self, selector, unfinished_ids=True))

    def select(self, selector: str) -> tuple[RunSummary, ...]:
        """The runs that a selector means, the newest first: one, or all of an experiment.

        Raises:
            UsageError: it means no run, or it is the beginning of several ids or hashes.
        """
        return selectors.select(self, selector)

    def tests(self, run: str) -> tuple[StoredTest, ...]:
        """The tests of a run in the order of their steps."""
        query = select(TESTS).where(TESTS.c.run == run).order_by(TESTS.c.steps)
        return tuple(StoredTest(*row) for row in self._read(query))

    def tests_of(self, runs: Sequence[str]) -> dict[str, tuple[StoredTest, ...]]:
        """The tests of each of these runs in the order of their steps."""
        found: dict[str, list[StoredTest]] = {run: [] for run in runs}
        for portion in chunks(runs):
            query = select(TESTS).where(TESTS.c.run.in_(portion)).order_by(TESTS.c.run, TESTS.c.steps)
            for row in self._read(query):
                found[row.run].append(StoredTest(*row))
        return {run: tuple(tests) for run, tests in found.items()}

    def spec(self, experiment: str) -> dict[str, Any]:
        """Resolved spec of an experiment, without its seeds; that of its oldest run.

        Raises:
            UsageError: there is no such experiment.
        """
        query = select(SPECS.c.spec).join(RUNS, RUNS.c.spec == SPECS.c.digest)
        rows = self._read(query.where(RUNS.c.experiment == experiment).order_by(RUNS.c.created, RUNS.c.run).limit(1))
        if not rows:
            raise UsageError(f"there is no experiment {experiment!r}", hint="`karolos runs list --json` names them")
        spec: dict[str, Any] = rows[0][0]
        return spec

    def parameters(self, run: str) -> dict[str, Any]:
        """The settings of a run's spec by their key paths, e.g. {"agent.learning_rate": 0.001}."""
        query = select(PARAMETERS.c.key, PARAMETERS.c.value).join(RUNS, RUNS.c.spec == PARAMETERS.c.spec)
        return stored_parameters(self._read(query.where(RUNS.c.run == run).order_by(PARAMETERS.c.key)))

    def versions(self, run: str) -> dict[str, str]:
        """Versions of the software that a run was made with; empty where they are not known."""
        query = select(VERSIONS.c.package, VERSIONS.c.version).join(RUNS, RUNS.c.software == VERSIONS.c.software)
        rows = self._read(query.where(RUNS.c.run == run).order_by(VERSIONS.c.package))
        return {row.package: row.version for row in rows}

    def _unknown(self, run: str) -> StoreError:
        return StoreError(
            f"the run {run} is not in the database",
            where=display(self.url),
            hint="was the database exchanged while the run went on? Its folder is complete; `karolos db reindex`",
        )

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """A transaction that writes, while no other does."""
        with explained(self.url), self._engine.begin() as connection:
            lock_writers(connection, self._timeout)
            yield connection

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """A transaction that only reads, and so waits for none that writes."""
        with explained(self.url), self._readers.connect() as connection:
            yield connection

    def _read(self, query: Executable) -> Sequence[Any]:
        with self.reading() as connection:
            return connection.execute(query).all()
