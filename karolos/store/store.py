"""Store: the index over all runs. The run folders are the truth; `reindex` rebuilds it from them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from types import TracebackType
from typing import Any

from sqlalchemy import Connection, Select, delete, func, insert, select, update
from sqlalchemy.dialects import postgresql, sqlite

from ..errors import RunError, StoreError, UsageError
from ..run_folder import RunFolder
from ..run_records import STATES, UNFINISHED, RunRecord, RunSummary
from ..testing import TestResult
from .connection import READ, display, explained, make_engine, parse_url, sqlite_file
from .models import ExperimentRow, RunRow, Table, TestRow
from .schema import ensure_schema

BUSY_SECONDS = 20.0
"""How long a transaction waits for another process's; whoever writes holds the lock for milliseconds."""
FILE_NAME = "karolos.sqlite"
_LISTED = 5
_SUMMARY_FIELDS = tuple(field.name for field in fields(RunSummary))


@dataclass(frozen=True)
class StoredTest:
    """One test of a run as the index keeps it: `any`, `end`, `reset` count episodes as in TestResult."""

    run: str
    steps: int
    seconds: float
    episodes: int
    any: int
    end: int
    reset: int

    @classmethod
    def of(cls, run: str, result: TestResult) -> StoredTest:
        counts = (sum(flags) for flags in (result.any, result.end, result.reset))
        return cls(run, int(result.steps), float(result.seconds), result.episodes, *counts)


class Store:
    """The results database. Safe for many processes at once; give each its own Store.

    Args:
        url: SQLAlchemy URL, e.g. sqlite:///runs/karolos.sqlite. A SQLite file that is not there is made.
        timeout: seconds a SQLite transaction waits for other processes.

    Raises:
        StoreError: from every method, when the database is locked, read-only, damaged, newer or not ours.
    """

    def __init__(self, url: str, *, timeout: float = BUSY_SECONDS) -> None:
        self.url = parse_url(url)
        path = sqlite_file(self.url)
        self._home = path.resolve().parent if path else None
        self._engine = make_engine(self.url, timeout)
        self._reading = self._engine.execution_options(**{READ: True})
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

    def add_run(self, summary: RunSummary, spec: Mapping[str, Any]) -> None:
        """Enter a run with its resolved spec, and its experiment if it is the first of it; replaces the run's row."""
        with explained(self.url), self._engine.begin() as connection:
            self._add_run(connection, summary, spec)

    def add_records(self, records: Sequence[RunRecord]) -> None:
        """Enter runs with all their tests, in place of those stored, in one transaction."""
        with explained(self.url), self._engine.begin() as connection:
            for record in records:
                run = record.summary.run
                self._add_run(connection, record.summary, record.spec)
                connection.execute(delete(TestRow).where(TestRow.run == run))
                if record.tests:
                    rows = [_test_row(StoredTest.of(run, result)) for result in record.tests]
                    connection.execute(insert(TestRow), rows)

    def _add_run(self, connection: Connection, summary: RunSummary, spec: Mapping[str, Any]) -> None:
        experiment = {"hash": summary.experiment, "name": summary.name, "spec": without_seeds(spec)}
        _upsert(connection, ExperimentRow, experiment, keys=("hash",), replace_old=False)
        _upsert(connection, RunRow, self._to_row(summary), keys=("run",))

    def update_run(self, summary: RunSummary) -> None:
        """Bring a run's row up to date.

        Raises:
            StoreError: the run is not there.
        """
        row = self._to_row(summary)
        with explained(self.url), self._engine.begin() as connection:
            changed = connection.execute(update(RunRow).where(RunRow.run == summary.run).values(**row))
            if changed.rowcount == 0:
                raise StoreError(
                    f"the run {summary.run} is not in the database",
                    where=display(self.url),
                    hint="was the database exchanged while the run went on? Its folder is complete",
                )

    def add_test(self, run: str, result: TestResult) -> None:
        """Enter a test of a run; one at the same steps, which a resumed run repeats, is replaced."""
        with explained(self.url), self._engine.begin() as connection:
            _upsert(connection, TestRow, _test_row(StoredTest.of(run, result)), keys=("run", "steps"))

    def remove_runs(self, runs: Sequence[str]) -> None:
        """Take runs and their tests out of the index; folders stay, and so do experiments."""
        with explained(self.url), self._engine.begin() as connection:
            for run in runs:
                connection.execute(delete(RunRow).where(RunRow.run == run))

    def runs(
        self,
        *,
        ids: Sequence[str] | None = None,
        prefix: str | None = None,
        state: str | None = None,
        limit: int | None = None,
    ) -> tuple[RunSummary, ...]:
        """Runs, the newest first.

        Where the index says that a run goes on and no process does it, its folder tells what became of it (`lost`, or
        an end that was not indexed any more).

        Args:
            ids: only these.
            prefix: only runs whose id begins so.
            state: only runs in this state, which may be `lost`.
            limit: not more than that many.

        Raises:
            UsageError: there is no such state.
        """
        query = select(RunRow.__table__).order_by(RunRow.created.desc(), RunRow.run.desc())
        if ids is not None:
            query = query.where(RunRow.run.in_(ids))
        if prefix is not None:
            query = query.where(func.substr(RunRow.run, 1, len(prefix)) == prefix)  # LIKE would ignore case on SQLite
        if state is None:
            return tuple(self._current(row) for row in self._read(query.limit(limit)))
        if state not in STATES:
            raise UsageError(f"there is no state {state!r}", hint=f"there are {', '.join(STATES)}")
        # A run that the index takes for unfinished may be in any state.
        query = query.where(RunRow.state.in_({state, *UNFINISHED}))
        found = (self._current(row) for row in self._read(query))
        return tuple(run for run in found if run.state == state)[:limit]

    def find(self, selector: str) -> RunSummary:
        """The one run that a selector means: an id, the beginning of one, a run folder's path, or @last.

        Raises:
            UsageError: it means no run, or several; names some.
        """
        if selector == "@last":
            newest = self.runs(limit=1)
            if not newest:
                raise UsageError("there are no runs yet", hint="`karolos run SPEC` makes one")
            return newest[0]
        name = Path(selector).name
        exact = self.runs(ids=[name])
        found = exact or (self.runs(prefix=name, limit=_LISTED + 1) if name else ())
        if len(found) == 1:
            return found[0]
        listed = ", ".join(run.run for run in found[:_LISTED]) + (" ..." if len(found) > _LISTED else "")
        if found:
            raise UsageError(f"{selector!r} means several runs", hint=f"one of {listed}; or @last")
        raise UsageError(f"{selector!r} means no run", hint="`karolos runs list` shows them; @last is the newest")

    def tests(self, run: str) -> tuple[StoredTest, ...]:
        """The tests of a run in the order of their steps."""
        query = select(TestRow.__table__).where(TestRow.run == run).order_by(TestRow.steps)
        return tuple(StoredTest(*row) for row in self._read(query))

    def spec(self, experiment: str) -> dict[str, Any]:
        """Resolved spec of an experiment, without its seeds.

        Raises:
            UsageError: there is no such experiment.
        """
        rows = self._read(select(ExperimentRow.spec).where(ExperimentRow.hash == experiment))
        if not rows:
            raise UsageError(f"there is no experiment {experiment!r}", hint="`karolos runs list --json` names them")
        spec: dict[str, Any] = rows[0][0]
        return spec

    def _read(self, query: Select[Any]) -> Sequence[Any]:
        with explained(self.url), self._reading.connect() as connection:
            return connection.execute(query).all()

    def _to_row(self, summary: RunSummary) -> dict[str, Any]:
        """Columns of a summary: a folder below the database is kept relative to it, so that both can move together."""
        folder = Path(summary.folder)
        if self._home and folder.is_relative_to(self._home):
            folder = folder.relative_to(self._home)
        return asdict(summary) | {"folder": folder.as_posix(), "seed": str(summary.seed)}

    def _current(self, row: Any) -> RunSummary:
        """The run as it is now."""
        values = {name: getattr(row, name) for name in _SUMMARY_FIELDS}
        folder = (self._home or Path()) / values["folder"]
        indexed = RunSummary(**values | {"folder": str(folder), "seed": int(values["seed"])})
        if indexed.state not in UNFINISHED or not os.path.isdir(folder):
            return indexed
        try:
            opened = RunFolder.open(folder)
            return indexed if opened.is_locked() else opened.summary()
        except RunError:
            return replace(indexed, state="lost")


def without_seeds(spec: Mapping[str, Any]) -> dict[str, Any]:
    """A resolved spec as all runs of an experiment share it."""
    return {key: value for key, value in spec.items() if key != "seeds"}


def _test_row(test: StoredTest) -> dict[str, Any]:
    return {
        "run": test.run,
        "steps": test.steps,
        "seconds": test.seconds,
        "episodes": test.episodes,
        "successes_any": test.any,
        "successes_end": test.end,
        "solved_at_reset": test.reset,
    }


def _upsert(
    connection: Connection, table: type[Table], row: dict[str, Any], *, keys: Sequence[str], replace_old: bool = True
) -> None:
    """Insert a row; where its key is there, replace the row or leave it."""
    dialect = postgresql if connection.dialect.name == "postgresql" else sqlite
    new = dialect.insert(table).values(**row)
    rest = {name: value for name, value in row.items() if name not in keys}
    statement = (
        new.on_conflict_do_update(index_elements=keys, set_=rest)
        if replace_old
        else new.on_conflict_do_nothing(index_elements=keys)
    )
    connection.execute(statement)
