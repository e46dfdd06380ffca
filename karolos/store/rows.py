"""Between frozen values and rows of tables."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Table, insert

from ..records.counting import TestCounts
from ..records.results import TestResult
from ..records.run_records import RunSummary, flatten

SUMMARY_COLUMNS = tuple(field.name for field in fields(RunSummary) if field.name != "tags")
ROWS_PER_STATEMENT = 500
"""Of an IN list: SQLite before 3.32 takes 999 parameters."""


@dataclass(frozen=True)
class StoredTest:
    """One test of a run as the index keeps it: `any`, `end`, `reset` count episodes as in TestResult."""

    run: str
    steps: int
    seconds: float
    episodes: int
    any: int
    end: int
    reset: int

    @classmethod
    def of(cls, run: str, test: TestResult | TestCounts) -> StoredTest:
        counts = TestCounts.of(test) if isinstance(test, TestResult) else test
        return cls(run, **vars(counts))

    def to_row(self) -> dict[str, Any]:
        return {
            "run": self.run,
            "steps": self.steps,
            "seconds": self.seconds,
            "episodes": self.episodes,
            "successes_any": self.any,
            "successes_end": self.end,
            "solved_at_reset": self.reset,
        }


def as_stored(folder: str, home: Path | None) -> str:
    """A folder as the index keeps it.

    Args:
        folder: its path.
        home: the database's folder. What lies below it is kept relative to it, so that both can move together.
    """
    path = Path(folder)
    return (path.relative_to(home) if home and path.is_relative_to(home) else path).as_posix()


def where_it_lies(stored: str, home: Path | None) -> str:
    """The path of a folder that the index keeps."""
    return str((home or Path()) / stored)


def run_row(summary: RunSummary, home: Path | None) -> dict[str, Any]:
    """Columns of a run but its labels, which have a way of their own; `home` as for `as_stored`."""
    row = {name: getattr(summary, name) for name in SUMMARY_COLUMNS if name != "note"}
    return row | {"folder": as_stored(summary.folder, home), "seed": str(summary.seed)}


def summary_of(row: Any, tags: Sequence[str], home: Path | None) -> RunSummary:
    """The run that a row of `runs` tells of."""
    values = {name: getattr(row, name) for name in SUMMARY_COLUMNS}
    values |= {"folder": where_it_lies(values["folder"], home), "seed": int(values["seed"])}
    return RunSummary(**values, tags=tuple(sorted(tags)))


def without_seeds(spec: Mapping[str, Any]) -> dict[str, Any]:
    """A resolved spec as all runs of an experiment share it."""
    return {key: value for key, value in spec.items() if key != "seeds"}


def digest(value: Mapping[str, Any]) -> str:
    """Name of a JSON object: SHA-256 (hex) of its canonical text."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def parameter_rows(spec: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    """One row for each setting of a spec that is known by the digest `name`."""
    # Of two key paths that read the same ({"a.b": 1} and {"a": {"b": 1}}) the later one.
    return [{"spec": name, "key": key, "value": json.dumps(value)} for key, value in dict(flatten(spec)).items()]


def upsert(
    connection: Connection,
    table: Table,
    rows: Sequence[Mapping[str, Any]],
    *,
    keys: Sequence[str],
    replace_old: bool = True,
) -> None:
    """Insert rows; where a key is there, replace the row or leave it."""
    if not rows:
        return
    # Both have the same methods; that of the other database would take longer to import than most queries.
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
    """Names in portions that fit into one IN list."""
    for start in range(0, len(names), ROWS_PER_STATEMENT):
        yield tuple(names[start : start + ROWS_PER_STATEMENT])
