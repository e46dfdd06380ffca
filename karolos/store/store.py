"""Store: the index over all runs. The run folders are the truth; `reindex` rebuilds the index from them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Unpack

from sqlalchemy import Connection, Table, bindparam, delete, select, update

from ..errors import StoreError
from ..records import RunFolder, labels
from ..records.results import TestCounts
from ..records.run_records import RunRecord, RunSummary
from . import selectors
from .database import BUSY_SECONDS, Database
from .experiments import ExperimentPage, find_experiments
from .rows import digest, put, run_row, without_seeds
from .runs import RunConditions, find_runs, records_of
from .sweeps import Sweeps
from .tables import RUNS, SOFTWARE, SPECS, SUCCESSES, TESTS

FILE_NAME = "karolos.sqlite"


class Store:
    """The results database. Safe for many processes at once; give each its own Store.

    Args:
        url: SQLAlchemy URL, e.g. sqlite:///runs/karolos.sqlite, or postgresql://host/name with the extra `postgres`.
            A SQLite file that does not exist is created.
        timeout: seconds a transaction that writes waits for other processes.
        upgrade: replace the tables of an older karolos; `reindex` then enters the runs.

    Attributes:
        database: the connection and its transactions.
        sweeps: the searches over specs, and their trials.

    Raises:
        StoreError: from every method, as those of Database.
    """

    def __init__(self, url: str, *, timeout: float = BUSY_SECONDS, upgrade: bool = False) -> None:
        self.database = Database(url, timeout=timeout, upgrade=upgrade)
        self.sweeps = Sweeps(self.database)

    exists = staticmethod(Database.exists)

    @staticmethod
    def default_url(runs: str | Path) -> str:
        """URL of the database in a runs folder."""
        return f"sqlite:///{Path(runs) / FILE_NAME}"

    def close(self) -> None:
        """Close every connection. Safe to call twice."""
        self.database.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add_records(self, records: Sequence[RunRecord]) -> None:
        """Enter runs with all their tests in one transaction. Of runs that are stored, only what changed is written."""
        contents: dict[Table, dict[str, Mapping[str, Any]]] = {SPECS: {}, SOFTWARE: {}}
        rows = []
        with self.database.writing() as connection:
            for record in records:
                folder, spec = Path(record.summary.folder), without_seeds(record.spec)
                shared = {"spec": digest(spec), "software": digest(record.versions)}
                contents[SPECS][shared["spec"]], contents[SOFTWARE][shared["software"]] = spec, record.versions
                # Read inside the transaction: the last writer has read everything that was written before.
                current = asdict(labels.read(folder)) if folder.is_dir() else {}
                rows.append(run_row(record.summary, self.database.home) | current | shared)
            for table, values in contents.items():
                shared_rows = [{"digest": name, "content": value} for name, value in values.items()]
                put(connection, table, shared_rows, replace_old=False)
            stored = connection.execute(select(RUNS.c.run, RUNS.c.name).where(_named(RUNS, records)))
            names: dict[str, str] = dict(iter(stored))
            put(connection, RUNS, rows)
            retested = _put_tests(connection, records)
            stale = {
                summary.experiment
                for summary in (record.summary for record in records)
                if summary.run in retested or names.get(summary.run) != summary.name
            }
            _for_each(connection, delete(SUCCESSES).where(SUCCESSES.c.experiment == bindparam("one")), stale)

    def refresh_labels(self, folder: RunFolder) -> None:
        """Copy a run's tags and note from its folder.

        Raises:
            StoreError: the run is not in the database.
        """
        with self.database.writing() as connection:
            change = update(RUNS).where(RUNS.c.run == folder.id).values(asdict(folder.labels()))
            if not connection.execute(change).rowcount:
                raise StoreError(
                    f"the run {folder.id} is not in the database",
                    where=self.database.name,
                    hint="its folder is complete; `karolos db reindex` enters it",
                )

    def remove_runs(self, runs: Sequence[str]) -> None:
        """Remove runs from the index, with their tests and everything that only they refer to; folders stay."""
        experiment = select(RUNS.c.experiment).where(RUNS.c.run == bindparam("one")).scalar_subquery()
        with self.database.writing() as connection:
            _for_each(connection, delete(SUCCESSES).where(SUCCESSES.c.experiment == experiment), runs)
            _for_each(connection, delete(RUNS).where(RUNS.c.run == bindparam("one")), runs)
            for digests, references in ((SPECS.c.digest, RUNS.c.spec), (SOFTWARE.c.digest, RUNS.c.software)):
                used = select(references).where(references == digests).exists()
                connection.execute(delete(digests.table).where(~used))

    def runs(self, **conditions: Unpack[RunConditions]) -> tuple[RunSummary, ...]:
        """Runs that meet all conditions, the newest first; see `runs.find_runs`."""
        return find_runs(self.database, **conditions)

    def experiments(self, where: str | None = None, **options: Any) -> ExperimentPage:
        """A page of the experiments with runs that match a filter; see `experiments.find_experiments`."""
        return find_experiments(self.database, where, **options)

    def find(self, selector: str) -> RunSummary:
        """The one run that a selector means (`selectors.select`). Raises UsageError if it means none, or several."""
        return selectors.only(selector, selectors.select(self.database, selector, all_prefixed=True))

    def select(self, selector: str, *, or_trial: bool = False) -> tuple[RunSummary, ...]:
        """The runs that a selector means: one, or all of an experiment; see `selectors.select`."""
        return selectors.select(self.database, selector, or_trial=or_trial)

    def records(self, found: Sequence[RunSummary]) -> tuple[RunRecord, ...]:
        """Everything that the index has of these runs: their specs without seeds, tests, and versions."""
        return records_of(self.database, found)


def _put_tests(connection: Connection, records: Sequence[RunRecord]) -> set[str]:
    """Make the stored tests of runs those of their records; returns the runs whose tests changed."""
    stored: dict[str, dict[int, TestCounts]] = defaultdict(dict)
    for run, steps, *numbers in connection.execute(select(TESTS).where(_named(TESTS, records))):
        stored[run][steps] = TestCounts(steps, *numbers)
    retested = set()
    for record in records:
        run, old, new = record.summary.run, stored[record.summary.run], {test.steps: test for test in record.tests}
        if old != new:
            retested.add(run)
            gone = delete(TESTS).where(TESTS.c.run == run, TESTS.c.steps == bindparam("one"))
            _for_each(connection, gone, old.keys() - new.keys())
            changed = [{"run": run, **vars(test)} for steps, test in new.items() if old.get(steps) != test]
            put(connection, TESTS, changed)
    return retested


def _named(table: Table, records: Sequence[RunRecord]) -> Any:
    """The condition that a row belongs to one of these runs."""
    return table.c.run.in_([record.summary.run for record in records])


def _for_each(connection: Connection, statement: Any, values: Any) -> None:
    """Execute a statement with each of some values as its parameter `one`."""
    if values:
        connection.execute(statement, [{"one": value} for value in values])
