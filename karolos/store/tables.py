"""Tables of the results database, and their rows as frozen values.

Times are ISO 8601 text in UTC, which sorts like the time on every database.

The tables are plain: SQLAlchemy's mapper takes longer to import than most queries take.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_type_hints

from sqlalchemy import JSON, BigInteger, Boolean, Column, Connection, Float, ForeignKey, Integer, MetaData, Table, Text
from sqlalchemy.types import TypeEngine

from ..errors import StoreError
from ..records.decode import from_json
from ..records.evaluation import COUNTS, Evaluation, Measured
from ..records.run_records import RunSummary

SCHEMA = 11
"""Version of these tables, stored in `karolos_schema`. Raise it with every change of the tables.

A database of another version is refused. The run folders are the truth: `karolos db upgrade` replaces older tables and
enters what the folders hold.
"""
OLDER_TABLES = ("experiments", "parameters", "versions", "tags", "trials", "sweeps")
"""Tables of version 0.1 (schema 7) and 0.2 (schemas 9 and 10) that this schema lacks."""
TABLES = MetaData()
SUMMARY_FIELDS = tuple(field.name for field in fields(RunSummary))
_TYPES: dict[Any, TypeEngine[Any]] = {
    bool: Boolean(),
    int: BigInteger(),
    float: Float(53),
    str: Text(),
}
_INDEXED = ("experiment", "state", "name", "created")


def _column(name: str, kind: TypeEngine[Any]) -> Column[Any]:
    """A column that is never null."""
    return Column(name, kind, nullable=False)


def _part_of_key(name: str, kind: TypeEngine[Any] | ForeignKey) -> Column[Any]:
    return Column(name, kind, primary_key=True, autoincrement=False)


def _columns(kind: type, *, key: str) -> Iterator[Any]:
    """A column for each field of a dataclass; lists and objects are JSON. `key` is part of the primary key."""
    for name, hint in get_type_hints(kind).items():
        options = get_args(hint)
        plain = options[0] if NoneType in options else hint
        stored = _TYPES.get(plain, JSON(none_as_null=True))
        nullable, indexed = NoneType in options, name in _INDEXED
        yield Column(name, stored, primary_key=name == key, nullable=nullable, index=indexed, autoincrement=False)


SCHEMA_VERSION = Table("karolos_schema", TABLES, _part_of_key("version", Integer()))
"""One row: the version of the tables. Only a karolos database has this table."""

SPECS = Table("specs", TABLES, _part_of_key("digest", Text()), _column("content", JSON()))
"""A resolved spec without its seeds, stored once for all runs with the same spec.

Specs of one experiment may differ in settings that do not change results: name, device, threads.
"""

SOFTWARE = Table("software", TABLES, _part_of_key("digest", Text()), _column("content", JSON()))
"""The versions of the packages of runs; empty if they are unknown."""

RUNS = Table(
    "runs",
    TABLES,
    *_columns(RunSummary, key="run"),
    Column("commit", Text()),
    Column("trial", Boolean(), nullable=False),
    Column("spec", ForeignKey("specs.digest"), nullable=False, index=True),
    Column("software", ForeignKey("software.digest"), nullable=False, index=True),
)
"""One spec, one seed: the fields of RunSummary, the git commit, and whether it belongs to a trial of a sweep.

`folder` is relative to the database's own folder below it.

Runs of the same `experiment` belong together: their results may be pooled.
"""

TESTS = Table(
    "tests",
    TABLES,
    _part_of_key("run", ForeignKey("runs.run", ondelete="CASCADE")),
    *(column for column in _columns(Evaluation, key="steps") if column.name in COUNTS),
)
"""One test of a run: the numbers of an Evaluation. The run folder holds the test episode by episode."""

SUCCESSES = Table(
    "success_summaries",
    TABLES,
    _part_of_key("experiment", Text()),
    _part_of_key("counting", Text()),  # any or end
    _part_of_key("reported", Boolean()),
    _part_of_key("steps", Float(53)),
    _column("runs", Integer()),
    *(_column(name, JSON()) for name in ("ratios", "modes", "density")),
    *(_column(name, Float(53)) for name in ("bandwidth", "mode", "mean", "low", "high")),
)
"""The kernel density of the success ratios of an experiment's compared runs: `Density` without its grid.

One row per step of the runs' tests, and one `reported` row for the reported ratios. A row lasts until a test or a run
of the experiment is added or removed.
"""


def as_stored(folder: str, home: Path | None) -> str:
    """A folder as the index stores it: relative if below the database's folder, so that both can move together."""
    path = Path(folder)
    return (path.relative_to(home) if home and path.is_relative_to(home) else path).as_posix()


def folder_path(stored: str, home: Path | None) -> str:
    """The path of a folder from what `as_stored` returned."""
    return str((home or Path()) / stored)


def summary_of(row: Any, home: Path | None) -> RunSummary:
    """The run of a row of `runs`. Raises StoreError if the row is damaged."""
    values = {name: getattr(row, name) for name in SUMMARY_FIELDS} | {"folder": folder_path(row.folder, home)}
    if (summary := from_json(RunSummary, values)) is None:
        raise StoreError(f"the row of the run {row.run} is damaged", hint="`karolos db reindex` enters it again")
    return summary


def means(measures: Mapping[str, Measured]) -> dict[str, float | None]:
    """The means of measures by their keys in filters: measures.peak_force."""
    return {f"measures.{name}": one["mean"] for name, one in measures.items()}


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
