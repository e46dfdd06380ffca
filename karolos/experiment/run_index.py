"""A run's entry in the results database, which is made from the run's folder."""

from __future__ import annotations

from types import TracebackType

from ..records import RunFolder
from ..store import Store


class RunIndex:
    """Enters a run into the results database and keeps the entry up to date; a context manager.

    The database is opened by the first update.

    Args:
        url: SQLAlchemy URL of the database; None: another process indexes the run, and nothing is done.
        folder: of the run.
    """

    def __init__(self, url: str | None, folder: RunFolder) -> None:
        self._url, self._folder = url, folder
        self._store: Store | None = None

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

    def update(self) -> None:
        """Enter the run as its folder is now.

        Raises:
            StoreError: the database cannot be used.
        """
        if self._url is None:
            return
        if self._store is None:
            self._store = Store(self._url)
        self._store.add_records([self._folder.record()])
