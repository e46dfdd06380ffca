"""Engines for the results database: SQLite so that many processes lose nothing, anything else by its URL.

SQLite, measured (facts of the project): the driver's default loses updates silently, WAL with a plain BEGIN fails when
a reader becomes a writer and has a race that corrupts before 3.51.3. So: rollback journal, BEGIN IMMEDIATE for writers,
a busy timeout, synchronous FULL, foreign keys on.
"""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, NoSuchModuleError
from sqlalchemy.pool import NullPool

from ..errors import StoreError
from ..records.provenance import redact

READ = "karolos_read"
"""Execution option of a connection that only reads, and so must not wait for writers."""

_ADVISORY_LOCK = 0x6B61726F  # any number, the same in every karolos
_REBUILD = "move the file away: a new one is built from the run folders"
_SQLITE = {
    sqlite3.SQLITE_BUSY: ("another process keeps it locked", "wait for that process, or stop it"),
    sqlite3.SQLITE_LOCKED: ("another process keeps it locked", "wait for that process, or stop it"),
    sqlite3.SQLITE_READONLY: ("the database is read-only", "change its permissions, or name another with --database"),
    sqlite3.SQLITE_NOTADB: ("the file is no database", "name another with --database, or move the file away"),
    sqlite3.SQLITE_CORRUPT: ("the database is damaged", _REBUILD),
    sqlite3.SQLITE_FULL: ("the disk is full", "free some space; what was stored before is whole"),
    sqlite3.SQLITE_IOERR: ("the disk fails or is full", "look at the disk; what was stored before is whole"),
    sqlite3.SQLITE_CANTOPEN: ("the database cannot be opened", "does its folder exist, and may it be read?"),
    sqlite3.SQLITE_PERM: ("the database may not be opened", "change its permissions"),
}


def parse_url(text: str) -> URL:
    """The URL of a database.

    Raises:
        StoreError: it is none, or a SQLite one without a file.
    """
    try:
        url = make_url(text)
    except ArgumentError as error:
        shown = "the database URL" if "@" in text else repr(text)  # a mistyped URL may still hold a password
        raise StoreError(f"{shown} is none", hint="e.g. sqlite:///runs/karolos.sqlite") from error
    if url.get_backend_name() == "sqlite" and (url.database in {None, "", ":memory:"} or "uri" in url.query):
        raise StoreError("a SQLite URL must name a file", where=display(url), hint="e.g. sqlite:///karolos.sqlite")
    return url


def display(url: URL) -> str:
    """The URL as it may be shown: without password and without the values of its query."""
    return url.set(query=dict.fromkeys(url.query, "***")).render_as_string(hide_password=True)


def sqlite_file(url: URL) -> Path | None:
    """The file of a SQLite database, None for any other."""
    return Path(url.database) if url.get_backend_name() == "sqlite" and url.database else None


def make_engine(url: URL, timeout: float, *, foreign_keys: bool = True) -> Engine:
    """An engine whose transactions lose nothing.

    Args:
        url: from `parse_url`.
        timeout: seconds that a SQLite transaction waits for another's lock.
        foreign_keys: whether SQLite holds them; a migration that makes tables anew must not lose what refers to them.

    Raises:
        StoreError: the driver is unknown or not installed.
    """
    path = sqlite_file(url)
    try:
        if path is not None:
            return _sqlite_engine(url, path, timeout, foreign_keys=foreign_keys)
        return create_engine(url, pool_pre_ping=True)
    except (NoSuchModuleError, ModuleNotFoundError) as error:
        raise StoreError(
            f"the database driver is missing ({error})",
            where=display(url),
            hint="for PostgreSQL: pip install karolos[postgres]",
        ) from error


def lock_writers(connection: Connection, timeout: float) -> None:
    """Let one transaction write after the other, on PostgreSQL, too: what is read before writing stays true.

    SQLite's transactions are so from their BEGIN IMMEDIATE on. The lock ends with the transaction.
    """
    if connection.dialect.name == "postgresql":
        connection.exec_driver_sql(f"SET LOCAL lock_timeout = {max(int(timeout * 1000), 1)}")
        connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({_ADVISORY_LOCK})")


def _sqlite_engine(url: URL, path: Path, timeout: float, *, foreign_keys: bool) -> Engine:
    # mode=rw: a database that was removed while runs write to it must not come back without its tables.
    address = f"{path.absolute().as_uri()}?mode=rw"

    def connect() -> sqlite3.Connection:
        connection = sqlite3.connect(address, uri=True, timeout=timeout, isolation_level=None)
        connection.execute(f"PRAGMA foreign_keys = {'ON' if foreign_keys else 'OFF'}")
        connection.execute("PRAGMA synchronous = FULL")
        return connection

    # A connection per transaction: it costs 0.1 ms, and none is shared with a forked process by accident.
    engine = create_engine(url, creator=connect, poolclass=NullPool)

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        read = connection.get_execution_options().get(READ, False)
        connection.exec_driver_sql("BEGIN" if read else "BEGIN IMMEDIATE")

    return engine


@contextlib.contextmanager
def explained(url: URL) -> Iterator[None]:
    """Turn what the database refuses inside the block into a StoreError that names the URL."""
    try:
        yield
    except DBAPIError as error:
        what, hint = _reason(error.orig)
        kind = ReadOnlyError if _is_read_only(error.orig) else StoreError
        raise kind(what, where=display(url), hint=hint) from error


class ReadOnlyError(StoreError):
    """The database may be read and not written."""


def _is_read_only(error: Any) -> bool:
    code = getattr(error, "sqlite_errorcode", None)
    return (code is not None and code & 0xFF == sqlite3.SQLITE_READONLY) or getattr(error, "sqlstate", None) == "25006"


def _reason(error: Any) -> tuple[str, str]:
    code = getattr(error, "sqlite_errorcode", None)
    if code is not None and code & 0xFF in _SQLITE:  # the low byte is the kind, the rest says more
        return _SQLITE[code & 0xFF]
    if getattr(error, "sqlstate", None) == "55P03":
        return _SQLITE[sqlite3.SQLITE_BUSY]
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return f"the database refuses ({redact(lines[0])})", "is the server up, and is the URL right?"
