"""A run's entry in the results database, which is made from the run's folder."""

from __future__ import annotations

from types import TracebackType

from ..errors import StoreError
from ..records import RunFolder
from ..records.results import TestResult
from ..store import Store


class RunIndex:
    """Enters a run into the results database and keeps the entry up to date; a context manager.

    The database is opened by the first update. After an update that failed, the next one enters the whole run again.

    Args:
        url: SQLAlchemy URL of the database; None: another process indexes the run, and nothing is done.
        folder: of the run.
    """

    def __init__(self, url: str | None, folder: RunFolder) -> None:
        self._url, self._folder = url, folder
        self._store: Store | None = None
        self._entered = False

    def __enter__(self) -> RunIndex:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the database. Safe to call twice."""
        if self._store is not None:
            self._store.close()

    def update(self, result: TestResult | None = None) -> None:
        """Copy the run's state from its folder.

        Args:
            result: a test that the folder has since the last update.

        Raises:
            StoreError: the database cannot be used.
        """
        if self._url is None:
            return
        try:
            if self._store is None:
                self._store = Store(self._url)
            if not self._entered:
                self._store.add_records([self._folder.record()])
                self._entered = True
                return
            if result is not None:
                self._store.add_test(self._folder.id, result)
            self._store.update_run(self._folder.summary())
        except StoreError:
            self._entered = False
            raise
