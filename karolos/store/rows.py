"""Conversion between frozen values and rows of tables."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

from sqlalchemy import Connection, Table

from ..errors import StoreError
from ..records.decode import from_json
from ..records.results import MeasureMean
from ..records.run_records import RunSummary

_T = TypeVar("_T")
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
    return summary.row() | {"folder": as_stored(summary.folder, home)}


def summary_of(row: Any, home: Path | None) -> RunSummary:
    """The run of a row of `runs`."""
    values = {name: getattr(row, name) for name in SUMMARY_FIELDS}
    return valid(RunSummary, values | {"folder": folder_path(row.folder, home)}, f"run {row.run}")


def valid(kind: type[_T], values: Mapping[str, Any], what: str) -> _T:
    """The value of a dataclass in a row; `what` names the row. Raises StoreError if the row is damaged."""
    value = from_json(kind, values)
    if value is None:
        raise StoreError(f"the row of the {what} is damaged", hint="`karolos db reindex` enters it again")
    return value


def means(measures: Mapping[str, MeasureMean]) -> dict[str, float | None]:
    """The means of measures by their keys in filters: measures.peak_force."""
    return {f"measures.{name}": one["mean"] for name, one in measures.items()}


def without_seeds(spec: Mapping[str, Any]) -> dict[str, Any]:
    """A resolved spec without its seeds: runs of an experiment share it."""
    return {key: value for key, value in spec.items() if key != "seeds"}


def digest(value: Mapping[str, Any]) -> str:
    """SHA-256 (hex) of the canonical text of a JSON object."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def put(connection: Connection, table: Table, rows: Sequence[Mapping[str, Any]], *, replace_old: bool = True) -> None:
    """Insert rows of the same columns, if there are any.

    Where the primary key exists, the row is replaced, or left if not `replace_old`.
    """
    if not rows:
        return
    # Both dialects have the same methods; importing the other one would take longer than most queries.
    dialect: Any = import_module(f"sqlalchemy.dialects.{connection.dialect.name}")
    new, keys = dialect.insert(table), [column.name for column in table.primary_key]
    rest = {name: new.excluded[name] for name in rows[0] if name not in keys}
    statement = (
        new.on_conflict_do_update(index_elements=keys, set_=rest) if replace_old else new.on_conflict_do_nothing()
    )
    connection.execute(statement, [dict(row) for row in rows])
