"""Store: the index over all runs. The run folders are the truth; `reindex` rebuilds the index from them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Unpack

from ..errors import StoreError
from ..records import RunFolder
from ..records.run_records import RunRecord, RunSummary
from . import selectors, writing
from .database import BUSY_SECONDS, Database
from .runs import RunConditions, closest_value, find_runs, records_of
from .sweeps import Sweeps

FILE_NAME = "karolos.sqlite"


class Store:
    """The results database. Safe for many processes at once; give each its own Store.

    Args:
        url: SQLAlchemy URL, e.g. sqlite:///runs/karolos.sqlite, or postgresql://host/name with the extra `postgres`.
            A SQLite file that does not exist is created.
        timeout: seconds a transaction that writes waits for other processes.

    Attributes:
        database: the connection and its transactions.
        sweeps: the searches over specs, and their trials.

    Raises:
        StoreError: from every method, as those of Database.
    """

    def __init__(self, url: str, *, timeout: float = BUSY_SECONDS) -> None:
        self.database = Database(url, timeout=timeout)
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def add_records(self, records: Sequence[RunRecord]) -> None:
        """Enter runs with all their tests in one transaction; replace those stored."""
        with self.database.writing() as connection:
            writing.enter(connection, records, self.database.home)

    def refresh_labels(self, folder: RunFolder) -> None:
        """Copy a run's tags and note from its folder.

        Raises:
            StoreError: the run is not in the database.
        """
        with self.database.writing() as connection:
            if not writing.refresh_labels(connection, folder.id, folder.path):
                raise StoreError(
                    f"the run {folder.id} is not in the database",
                    where=self.database.name,
                    hint="its folder is complete; `karolos db reindex` enters it",
                )

    def remove_runs(self, runs: Sequence[str]) -> None:
        """Remove runs from the index, with their tests and everything that only they refer to; folders stay."""
        with self.database.writing() as connection:
            writing.remove(connection, runs)

    def runs(self, **conditions: Unpack[RunConditions]) -> tuple[RunSummary, ...]:
        """Runs that meet all conditions (`RunConditions`), the newest first; see `find_runs`."""
        return find_runs(self.database, **conditions)

    def closest_value(self, where: str) -> str | None:
        """What a filter that matches no run may mean; see `runs.closest_value`."""
        return closest_value(self.database, where)

    def find(self, selector: str) -> RunSummary:
        """The one run that a selector means (`selectors.select`).

        Raises:
            UsageError: it means no run, or several; names some.
        """
        return selectors.only(selector, selectors.select(self.database, selector, all_prefixed=True))

    def select(self, selector: str) -> tuple[RunSummary, ...]:
        """The runs that a selector means, the newest first: one, or all of an experiment.

        Raises:
            UsageError: it means no run, or is the beginning of several ids or hashes.
        """
        return selectors.select(self.database, selector)

    def records(self, runs: Sequence[RunSummary]) -> tuple[RunRecord, ...]:
        """Everything that the index has of these runs: their specs without seeds, tests, and versions."""
        return records_of(self.database, runs)
