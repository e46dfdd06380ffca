"""Bringing a database of an older karolos up to date: all or nothing, and never without a copy of a file."""

from __future__ import annotations

import os
import sqlite3
from contextlib import closing
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from alembic.migration import MigrationContext
from alembic.operations import Operations
from sqlalchemy import URL, Connection, Engine, text, update

from ..errors import StoreError
from ..files import writing
from .connection import display, explained, lock_writers, make_engine, parse_url, sqlite_file
from .schema import alone, schema_version
from .tables import SCHEMA, SCHEMA_VERSION

SECONDS = 20.0
"""How long an upgrade waits for whoever uses the database."""


@dataclass(frozen=True)
class Upgraded:
    """From which version to which, and where the copy of a SQLite file lies; None where nothing was to be done."""

    before: int
    after: int
    backup: Path | None


def upgrade(url: str, *, timeout: float = SECONDS) -> Upgraded:
    """Change the tables of a database to this karolos's version, in one transaction.

    A SQLite file is copied first; any other database is its administrator's to back up.

    Args:
        url: of a database that is there.
        timeout: seconds to wait for other processes.

    Raises:
        StoreError: there is none, it is not ours, newer, in use for too long, or cannot be written; it is as before.
    """
    place = parse_url(url)
    path = sqlite_file(place)
    if path is not None and not os.path.exists(path):
        raise StoreError("there is no database", where=display(place), hint="`karolos db reindex` makes one")
    engine = make_engine(place, timeout, foreign_keys=False)
    try:
        with alone(place, timeout):
            return _upgrade(engine, place, path, timeout)
    finally:
        engine.dispose()


def _upgrade(engine: Engine, url: URL, path: Path | None, timeout: float) -> Upgraded:
    # Writers are locked out from the first look to the last, so that the copy is what is changed.
    with explained(url), engine.begin() as connection:
        lock_writers(connection, timeout)
        before = schema_version(connection, url)
        if before is None:
            raise StoreError("the database is empty", where=display(url), hint="`karolos db reindex` fills it")
        if before == SCHEMA:
            return Upgraded(before, SCHEMA, None)
        backup = None if path is None else _copy(path, before)
        for version in range(before + 1, SCHEMA + 1):
            _migrate(connection, url, version)
        connection.execute(update(SCHEMA_VERSION).values(version=SCHEMA))
        _check_references(connection, url)
    return Upgraded(before, SCHEMA, backup)


def _migrate(connection: Connection, url: URL, version: int) -> None:
    try:
        module = import_module(f"{__package__}.migrations.v{version}")
    except ModuleNotFoundError as error:
        raise StoreError(
            f"no way leads from schema {version - 1} to {version}",
            where=display(url),
            hint="move it away: a new one is built from the run folders",
        ) from error
    module.migrate(Operations(MigrationContext.configure(connection)))


def _check_references(connection: Connection, url: URL) -> None:
    if connection.dialect.name == "sqlite" and connection.execute(text("PRAGMA foreign_key_check")).first():
        raise StoreError(
            "the database contradicts itself, so it was left as it is",
            where=display(url),
            hint="move it away: a new one is built from the run folders",
        )


def _copy(path: Path, version: int) -> Path:
    """A copy of a SQLite database that nobody writes to, under a name that is free."""
    for number in range(1, 1000):
        target = path.with_name(f"{path.name}.schema{version}" + (f"-{number}" if number > 1 else ""))
        if not target.exists():
            break
    with writing(target), closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as source:
        with closing(sqlite3.connect(target)) as copy:
            source.backup(copy)
        with target.open("rb+") as file:
            os.fsync(file.fileno())
    return target
