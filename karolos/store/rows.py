"""Conversion between frozen values and rows of tables."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Table, insert

from ..records.run_records import RunSummary

SUMMARY_FIELDS = tuple(field.name for field in fields(RunSummary))


def as_stored(folder: str, home: Path | None) -> str:
    """A folder as the index stores it.

    Args:
        folder: its path.
        home: the database's folder. A folder below it is stored relative to it, so that both can move together.
    """
    path = Path(folder)
    return (path.relative_to(home) if home and path.is_relative_to(home) else path).as_posix()


def folder_path(stored: str, home: Path | None) -> str:
    """The path of a folder from what `as_stored` returned."""
    return str((home or Path()) / stored)


def run_row(summary: RunSummary, home: Path | None) -> dict[str, Any]:
    """Columns of a run's summary; `home` as for `as_stored`."""
    return summary.row() | {"folder": as_stored(summary.folder, home), "seed": str(summary.seed)}


def summary_of(row: Any, home: Path | None) -> RunSummary:
    """The run of a row of `runs`."""
    values = {name: getattr(row, name) for name in SUMMARY_FIELDS}
    values |= {"folder": folder_path(row.folder, home), "seed": int(row.seed), "tags": tuple(row.tags)}
    return RunSummary(**values)


def without_seeds(spec: Mapping[str, Any]) -> dict[str, Any]:
    """A resolved spec without its seeds: runs of an experiment share it."""
    return {key: value for key, value in spec.items() if key != "seeds"}


def digest(value: Mapping[str, Any]) -> str:
    """SHA-256 (hex) of the canonical text of a JSON object."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def put(
    connection: Connection, table: Table, rows: Sequence[Mapping[str, Any]], *, replace_old: bool | None = None
) -> None:
    """Insert rows, if there are any.

    Args:
        connection: of a transaction that writes.
        table: gets the rows.
        rows: all with the same columns.
        replace_old: where the primary key exists: replace the row, or leave it (False). None: no key exists.
    """
    if not rows:
        return
    if replace_old is None:
        connection.execute(insert(table), [dict(row) for row in rows])
        return
    # Both dialects have the same methods; importing the other one would take longer than most queries.
    dialect: Any = import_module(f"sqlalchemy.dialects.{connection.dialect.name}")
    new, keys = dialect.insert(table), [column.name for column in table.primary_key]
    rest = {name: new.excluded[name] for name in rows[0] if name not in keys}
    statement = (
        new.on_conflict_do_update(index_elements=keys, set_=rest) if replace_old else new.on_conflict_do_nothing()
    )
    connection.execute(statement, [dict(row) for row in rows])
