"""Conversion between frozen values and rows of tables."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Table, insert

from ..records.results import TestCounts
from ..records.run_records import RunSummary, flatten

SUMMARY_COLUMNS = tuple(field.name for field in fields(RunSummary) if field.name != "tags")
ROWS_PER_STATEMENT = 500
"""Longest IN list: SQLite before 3.32 takes 999 parameters."""


def test_row(run: str, test: TestCounts) -> dict[str, Any]:
    """Columns of a test."""
    return {
        "run": run,
        "steps": test.steps,
        "seconds": test.seconds,
        "episodes": test.episodes,
        "successes_any": test.any,
        "successes_end": test.end,
        "solved_at_reset": test.reset,
        "mean_return": test.mean_return,
    }


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
    """Columns of a run except its labels; `home` as for `as_stored`."""
    row = {name: getattr(summary, name) for name in SUMMARY_COLUMNS if name != "note"}
    return row | {"folder": as_stored(summary.folder, home), "seed": str(summary.seed)}


def summary_of(row: Any, tags: Sequence[str], home: Path | None) -> RunSummary:
    """The run of a row of `runs`."""
    values = {name: getattr(row, name) for name in SUMMARY_COLUMNS}
    values |= {"folder": folder_path(values["folder"], home), "seed": int(values["seed"])}
    return RunSummary(**values, tags=tuple(sorted(tags)))


def without_seeds(spec: Mapping[str, Any]) -> dict[str, Any]:
    """A resolved spec without its seeds: runs of an experiment share it."""
    return {key: value for key, value in spec.items() if key != "seeds"}


def digest(value: Mapping[str, Any]) -> str:
    """SHA-256 (hex) of the canonical text of a JSON object."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def parameter_rows(spec: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    """One row for each setting of the spec whose digest is `name`."""
    # dict: of two equal key paths ({"a.b": 1} and {"a": {"b": 1}}) the later one counts.
    return [{"spec": name, "key": key, "value": json.dumps(value)} for key, value in dict(flatten(spec)).items()]


def upsert(
    connection: Connection,
    table: Table,
    rows: Sequence[Mapping[str, Any]],
    *,
    keys: Sequence[str],
    replace_old: bool = True,
) -> None:
    """Insert rows; where the key exists, replace the row or leave it."""
    if not rows:
        return
    # Both dialects have the same methods; importing the other one would take longer than most queries.
    dialect: Any = import_module(f"sqlalchemy.dialects.{connection.dialect.name}")
    new = dialect.insert(table)
    rest = {name: new.excluded[name] for name in rows[0] if name not in keys}
    statement = (
        new.on_conflict_do_update(index_elements=keys, set_=rest)
        if replace_old and rest
        else new.on_conflict_do_nothing(index_elements=keys)
    )
    connection.execute(statement, [dict(row) for row in rows])


def put(connection: Connection, table: Table, rows: Sequence[Mapping[str, Any]]) -> None:
    """Insert rows, if there are any."""
    if rows:
        connection.execute(insert(table), [dict(row) for row in rows])


def chunks(names: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Names in groups that fit into one IN list."""
    for start in range(0, len(names), ROWS_PER_STATEMENT):
        yield tuple(names[start : start + ROWS_PER_STATEMENT])
