"""Database: the connection to the results database and its transactions, on SQLite or any other URL.

Measured for SQLite: the driver's default loses updates silently. WAL with a plain BEGIN fails when a reader becomes a
writer, and before 3.51.3 a race corrupts the file. Therefore: rollback journal, BEGIN IMMEDIATE for writers, a busy
timeout, synchronous FULL, foreign keys on.
"""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from sqlalchemy import (
    URL,
    Connection,
    Engine,
    Executable,
    MetaData,
    create_engine,
    event,
    insert,
    inspect,
    make_url,
    select,
)
from sqlalchemy.exc import ArgumentError, DataError, DBAPIError, IntegrityError, NoSuchModuleError
from sqlalchemy.pool import NullPool

from .. import system
from ..errors import StoreError, redact
from ..system.files import writing as writing_file
from .tables import OLDER_TABLES, SCHEMA, SCHEMA_VERSION, TABLES

BUSY_SECONDS = 20.0
"""Time that a transaction waits for other processes, which hold the lock for milliseconds."""
_READ = "karolos_read"
"""Execution option of a connection that only reads and therefore does not wait for writers."""
_CHANGE_COUNTER = 24
"""Place of the counter of transactions in the header of SQLite's file (https://www.sqlite.org/fileformat.html)."""
_ADVISORY_LOCK = 0x6B61726F  # arbitrary, the same in every karolos
_LOCK_NOT_AVAILABLE = "55P03"
"""PostgreSQL's code of the error after `lock_timeout`."""
_NO_RIGHT = "42501"
"""PostgreSQL's code of the error of a role without the right."""
_REBUILD = "move it away and run `karolos db reindex`, which builds a new one from the run folders"
_REBUILD_ON_SERVER = "name an empty one with --database; `karolos db reindex` fills it from the run folders"
_LOCKED = ("another process keeps the database locked", "wait for that process, or stop it")
_SQLITE_ERRORS = {
    sqlite3.SQLITE_BUSY: _LOCKED,
    sqlite3.SQLITE_LOCKED: _LOCKED,
    sqlite3.SQLITE_READONLY: ("the database is read-only", "change its permissions, or name another with --database"),
    sqlite3.SQLITE_NOTADB: ("the file is not a database", "name another with --database, or move the file away"),
    sqlite3.SQLITE_CORRUPT: ("the database is damaged", _REBUILD),
    sqlite3.SQLITE_FULL: ("the disk is full", "free some space; what was stored before is intact"),
    sqlite3.SQLITE_IOERR: ("the disk is full or fails", "check the disk; what was stored before is intact"),
    sqlite3.SQLITE_CANTOPEN: ("the database cannot be opened", "check that its folder exists and can be read"),
    sqlite3.SQLITE_PERM: ("access to the database is denied", "change its permissions"),
}


class RefusedValueError(StoreError):
    """A value that the database cannot store."""


class Database:
    """A results database: its URL and its transactions. A SQLite file that does not exist is created.

    Args:
        url: SQLAlchemy URL, e.g. sqlite:///runs/karolos.sqlite.
        timeout: seconds a transaction that writes waits for other processes.
        upgrade: replace the tables of an older karolos by empty ones of this one.

    Attributes:
        forgotten: runs in the tables that `upgrade` replaced; None if it replaced nothing.
        url: parsed.
        name: the URL without its password, for messages.
        home: folder of a SQLite database, None for any other.
        engine: SQLAlchemy's; `reading` and `writing` are nearly always better.

    Raises:
        StoreError: from every method, if the database is locked, read-only, damaged, not a karolos database or of
            another schema.
    """

    def __init__(self, url: str, *, timeout: float = BUSY_SECONDS, upgrade: bool = False) -> None:
        self.forgotten: frozenset[str] | None = None
        self.url = _parse_url(url)
        self.name = _without_secrets(self.url)
        self._path = _sqlite_file(self.url)
        self.home = self._path.resolve().parent if self._path else None
        if self.home and (share := system.network_share(self.home)):
            raise StoreError(
                f"SQLite loses data on a network share ({share})",
                where=self.name,
                hint="keep the runs there, and name a file of this machine or PostgreSQL with --database",
            )
        self._timeout = timeout
        self.engine = _make_engine(self.url, self._path, timeout)
        self._readers = self.engine.execution_options(**{_READ: True})
        self._ensure_tables(upgrade)

    @staticmethod
    def exists(url: str) -> bool:
        """Whether there is a database to open, not only an empty file; always true unless it is SQLite."""
        path = _sqlite_file(_parse_url(url))
        return path is None or (os.path.exists(path) and os.path.getsize(path) > 0)

    def close(self) -> None:
        """Close every connection. Safe to call twice."""
        self.engine.dispose()

    def version(self) -> bytes:
        """A value that changes with every writing transaction, or always if this is unknown. SQLite needs no query.

        PostgreSQL counts the transactions of a whole server: writes to its other databases change it, too.
        """
        if self.engine.dialect.name == "postgresql":
            with self.reading() as connection:
                return str(connection.exec_driver_sql("SELECT pg_current_snapshot()::text").scalar()).encode()
        try:
            with open(self._path or os.devnull, "rb") as file:
                file.seek(_CHANGE_COUNTER)
                return file.read(4) or os.urandom(8)
        except OSError:
            return os.urandom(8)

    @contextlib.contextmanager
    def reading(self) -> Iterator[Connection]:
        """A transaction that only reads and does not wait for writers."""
        with explained(self.url), self._readers.connect() as connection:
            yield connection

    @contextlib.contextmanager
    def writing(self) -> Iterator[Connection]:
        """A transaction that writes while no other does."""
        with explained(self.url), self.engine.begin() as connection:
            if connection.dialect.name == "postgresql":
                # SQLite's BEGIN IMMEDIATE does the same. The lock ends with the transaction.
                connection.exec_driver_sql(f"SET LOCAL lock_timeout = {max(int(self._timeout * 1000), 1)}")
                connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({_ADVISORY_LOCK})")
            yield connection

    def fetch(self, query: Executable) -> Sequence[Any]:
        """The rows of one query."""
        with self.reading() as connection:
            return connection.execute(query).all()

    def _ensure_tables(self, upgrade: bool) -> None:
        """Create the tables in a database that is new, empty or to be upgraded. Refuse a foreign database."""
        if self._path is not None and not os.path.exists(self._path):  # Path.exists raises where it may not search
            with writing_file(self._path):
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self._path.touch()
        with self.reading() as connection:
            if self._check_schema(connection, upgrade):
                return
        with self.writing() as connection:
            if not self._check_schema(connection, upgrade):  # the first process creates them
                older = MetaData()
                older.reflect(connection, only=lambda name, _: name in {*TABLES.tables, *OLDER_TABLES})
                if "runs" in older.tables:
                    self.forgotten = frozenset(connection.scalars(select(older.tables["runs"].c.run)))
                older.drop_all(connection)
                TABLES.create_all(connection)
                connection.execute(insert(SCHEMA_VERSION).values(version=SCHEMA))

    def _check_schema(self, connection: Connection, upgrade: bool) -> bool:
        """Whether the tables exist; False for an empty database, and for an older one with `upgrade`.

        Raises StoreError if the database belongs to another program or has another schema.
        """
        rebuild = _rebuilding(self.url)
        tables = set(inspect(connection).get_table_names())
        if SCHEMA_VERSION.name not in tables:
            if tables:
                hint = f"name another with --database, or {rebuild}" if self._path else rebuild
                raise StoreError("this database belongs to another program", where=self.name, hint=hint)
            return False
        version: int | None = connection.scalar(select(SCHEMA_VERSION.c.version))
        if version is None:
            raise StoreError("the database is damaged: its schema version is missing", where=self.name, hint=rebuild)
        if version == SCHEMA or (version < SCHEMA and upgrade):
            return version == SCHEMA
        age, hint = ("a newer", rebuild) if version > SCHEMA else ("an older", "`karolos db upgrade` renews it")
        what = f"{age} karolos made this database (schema {version}, this karolos reads {SCHEMA})"
        raise StoreError(what, where=self.name, hint=hint)


@contextlib.contextmanager
def explained(url: URL) -> Iterator[None]:
    """Turn an error of the driver inside the block into a StoreError that names the URL."""
    try:
        yield
    except json.JSONDecodeError as error:
        what = "the database is damaged: a column does not hold JSON"
        raise StoreError(what, where=_without_secrets(url), hint=_rebuilding(url)) from error
    except (DataError, IntegrityError, OverflowError, UnicodeError) as error:
        what = f"the database refuses a value ({_first_line(error)})"
        hint = "a file of the run was damaged or edited"
        raise RefusedValueError(what, where=_without_secrets(url), hint=hint) from error
    except DBAPIError as error:
        # An error of SQLite has its kind in the low byte of its code.
        kind = getattr(error.orig, "sqlite_errorcode", 0) & 0xFF
        if kind not in _SQLITE_ERRORS and getattr(error.orig, "sqlstate", None) == _LOCK_NOT_AVAILABLE:
            kind = sqlite3.SQLITE_BUSY
        hint = "check that the server is up, and user, password and name of the database in the URL"
        if getattr(error.orig, "sqlstate", None) == _NO_RIGHT:
            hint = "name another role in the URL, or ask the owner of the database for the right"
        default = f"the database refuses ({_first_line(error)})", hint
        what, hint = _SQLITE_ERRORS.get(kind, default)
        if (path := _sqlite_file(url)) is not None and path.is_dir():
            what, hint = "a folder is in the way of the database's file", "move it away, or name a file with --database"
        raise StoreError(what, where=_without_secrets(url), hint=hint) from error


def _rebuilding(url: URL) -> str:
    """How to get a new database, as a hint."""
    return _REBUILD_ON_SERVER if _sqlite_file(url) is None else _REBUILD


def _first_line(error: Exception) -> str:
    """The driver's message without passwords."""
    driver = getattr(error, "orig", None) or error
    return redact((str(driver).strip().splitlines() or [type(driver).__name__])[0])


def _parse_url(text: str) -> URL:
    try:
        url = make_url(text)
    except (ArgumentError, ValueError) as error:  # a ValueError: the port is not a number
        shown = "what was given" if "@" in text else repr(text)  # an invalid URL may still hold a password
        raise StoreError(
            f"{shown} is not a database URL", hint="e.g. sqlite:///runs/karolos.sqlite, postgresql://me@host:5432/name"
        ) from error
    if url.get_backend_name() == "sqlite" and (url.database in {None, "", ":memory:"} or "uri" in url.query):
        raise StoreError(
            "a SQLite URL must name a file", where=_without_secrets(url), hint="e.g. sqlite:///karolos.sqlite"
        )
    return url


def _without_secrets(url: URL) -> str:
    """The URL without password and without the values of its query."""
    if (path := _sqlite_file(url)) is not None and not url.query:
        return sqlite_url(path)
    return url.set(query=dict.fromkeys(url.query, "***")).render_as_string(hide_password=True)


def sqlite_url(path: Path) -> str:
    """The URL of a SQLite file, whose name may have any characters."""
    return f"sqlite:///{path.as_posix()}".replace("%", "%25").replace("?", "%3F")


def _sqlite_file(url: URL) -> Path | None:
    return Path(url.database) if url.get_backend_name() == "sqlite" and url.database else None


def _make_engine(url: URL, path: Path | None, timeout: float) -> Engine:
    """The engine for a URL; `path` is the file of a SQLite database."""

    def connect() -> sqlite3.Connection:
        assert path is not None
        # mode=rw: a database that was removed while runs write to it must not come back without its tables.
        address = f"{path.absolute().as_uri()}?mode=rw"
        connection = sqlite3.connect(address, uri=True, timeout=timeout, isolation_level=None)
        connection.execute("PRAGMA foreign_keys = ON")
        connection.execute("PRAGMA synchronous = FULL")
        return connection

    # One connection per transaction costs 0.1 ms, and a forked process cannot share one by accident.
    sqlite: dict[str, Any] = {"creator": connect, "poolclass": NullPool}
    try:
        # A server that a plain locale made has no encoding: without this it answers in bytes.
        server = {"pool_pre_ping": True, "connect_args": {"client_encoding": "utf8"}}
        engine = create_engine(url, **sqlite if path else server)
    except (NoSuchModuleError, ModuleNotFoundError) as error:
        what, hint = f"the database driver is missing ({error})", "for postgresql://...: pip install karolos[postgres]"
        raise StoreError(what, where=_without_secrets(url), hint=hint) from error

    def begin(connection: Connection) -> None:
        read = connection.get_execution_options().get(_READ, False)
        connection.exec_driver_sql("BEGIN" if read else "BEGIN IMMEDIATE")

    if path:
        event.listen(engine, "begin", begin)
    return engine
