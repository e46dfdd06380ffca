"""Making a results database, and telling one from anything else."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

from sqlalchemy import URL, Connection, Engine, insert, inspect, select

from ..errors import StoreError
from ..files import FileLock, writing
from .connection import READ, display, explained, lock_writers, sqlite_file
from .tables import SCHEMA, SCHEMA_VERSION, TABLES


def ensure_schema(engine: Engine, url: URL, timeout: float) -> None:
    """Make the tables if the database is empty or not there; refuse one that is not ours.

    Raises:
        StoreError: it holds other tables, a newer or an older schema, or cannot be made.
    """
    path = sqlite_file(url)
    if path is not None and not os.path.exists(path):  # Path.exists raises where a folder may not be searched
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
    elif _is_ready(engine, url):
        return
    with alone(url, timeout):
        if path is not None:
            with writing(path):
                path.touch()
        _create(engine, url, timeout)


@contextlib.contextmanager
def alone(url: URL, timeout: float) -> Iterator[None]:
    """Keep other processes from making or changing the tables meanwhile; PostgreSQL does that by `lock_writers`."""
    path = sqlite_file(url)
    if path is None:
        yield
        return
    lock = FileLock(path.with_name(f"{path.name}.lock"))
    if not lock.acquire(timeout):
        raise StoreError("another process is still making it", where=display(url), hint="try again")
    try:
        yield
    finally:
        lock.release()


def schema_version(connection: Connection, url: URL) -> int | None:
    """Version of the tables; None for an empty database.

    Raises:
        StoreError: the database belongs to something else, or to a newer karolos.
    """
    tables = set(inspect(connection).get_table_names())
    if SCHEMA_VERSION.name not in tables:
        if tables:
            raise StoreError(
                "this database belongs to something else", where=display(url), hint="name another with --database"
            )
        return None
    version: int | None = connection.scalar(select(SCHEMA_VERSION.c.version))
    if version is None:
        raise StoreError("the database is damaged: it has no version", where=display(url), hint="move it away")
    if version > SCHEMA:
        raise StoreError(
            f"a newer karolos made this database (schema {version}, this one knows {SCHEMA})",
            where=display(url),
            hint="update karolos, or name another database with --database",
        )
    return version


def _is_ready(engine: Engine, url: URL) -> bool:
    with explained(url), engine.connect().execution_options(**{READ: True}) as connection:
        return _check(connection, url)


def _create(engine: Engine, url: URL, timeout: float) -> None:
    """All tables in one transaction, by whoever comes first."""
    with explained(url), engine.begin() as connection:
        lock_writers(connection, timeout)
        if not _check(connection, url):
            TABLES.create_all(connection)
            connection.execute(insert(SCHEMA_VERSION).values(version=SCHEMA))


def _check(connection: Connection, url: URL) -> bool:
    """Whether the tables are there in our version; False for an empty database."""
    version = schema_version(connection, url)
    if version is not None and version < SCHEMA:
        raise StoreError(
            f"an older karolos made this database (schema {version}, this one needs {SCHEMA})",
            where=display(url),
            hint="`karolos db upgrade` brings it up to date and keeps a copy",
        )
    return version is not None
