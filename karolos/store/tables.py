"""Tables of the results database. Times are ISO 8601 text in UTC, which sorts like the time on every database.

The tables are plain: SQLAlchemy's mapper takes longer to import than most queries take.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from types import NoneType
from typing import Any, get_args, get_type_hints

from sqlalchemy import JSON, BigInteger, Boolean, Column, Float, ForeignKey, Integer, MetaData, Table, Text
from sqlalchemy.types import TypeEngine

from ..records.results import TestCounts
from ..records.run_records import RunSummary
from ..records.sweep_records import SweepRecord, SweepTrialState, Trial

SCHEMA = 10
"""Version of these tables, stored in `karolos_schema`. Raise it with every change of the tables.

A database of another version is refused. The run folders are the truth: `karolos db upgrade` replaces older tables and
enters what the folders hold.
"""
OLDER_TABLES = ("experiments", "parameters", "versions", "tags")
"""Tables of schema 7, which version 0.1 made, that this schema lacks."""
TABLES = MetaData()
_TYPES: dict[Any, TypeEngine[Any]] = {
    bool: Boolean(),
    int: BigInteger(),
    float: Float(53),
    str: Text(),
    SweepTrialState: Text(),
}
_INDEXED = ("experiment", "state", "name", "created")


def _column(name: str, kind: TypeEngine[Any]) -> Column[Any]:
    """A column that is never null."""
    return Column(name, kind, nullable=False)


def _part_of_key(name: str, kind: TypeEngine[Any] | ForeignKey) -> Column[Any]:
    return Column(name, kind, primary_key=True, autoincrement=False)


def _owner(column: str) -> ForeignKey:
    """The row that this row belongs to and is deleted with."""
    return ForeignKey(column, ondelete="CASCADE")


def _columns(kind: type, *, key: str, without: Collection[str] = ()) -> Iterator[Any]:
    """A column for each field of a dataclass; lists and objects are JSON.

    Args:
        kind: the dataclass.
        key: its field that is part of the primary key.
        without: fields that have no column.
    """
    for name, hint in get_type_hints(kind).items():
        if name in without:
            continue
        options = get_args(hint)
        plain = options[0] if NoneType in options else hint
        stored = _TYPES.get(plain, JSON(none_as_null=True))
        nullable, indexed = NoneType in options, name in _INDEXED
        yield Column(name, stored, primary_key=name == key, nullable=nullable, index=indexed, autoincrement=False)


SCHEMA_VERSION = Table("karolos_schema", TABLES, _part_of_key("version", Integer()))
"""One row: the version of the tables. Only a karolos database has this table."""

SPECS = Table("specs", TABLES, _part_of_key("digest", Text()), _column("content", JSON()))
"""A resolved spec without its seeds, stored once for all runs that have exactly this one.

Specs of one experiment may differ in what results do not depend on: name, device, threads.
"""

SOFTWARE = Table("software", TABLES, _part_of_key("digest", Text()), _column("content", JSON()))
"""The versions of the packages that runs were made with; empty if they are unknown."""

RUNS = Table(
    "runs",
    TABLES,
    *_columns(RunSummary, key="run"),
    Column("spec", ForeignKey("specs.digest"), nullable=False, index=True),
    Column("software", ForeignKey("software.digest"), nullable=False, index=True),
)
"""One spec, one seed: the fields of RunSummary. `folder` is relative to the database's own folder below it.

Runs of the same `experiment` belong together: their results may be pooled.
"""

TESTS = Table("tests", TABLES, _part_of_key("run", _owner("runs.run")), *_columns(TestCounts, key="steps"))
"""One test of a run: the fields of TestCounts. The run folder holds the test episode by episode."""

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

One row per step at which the runs were tested, and one `reported` row of the ratios that the runs report. A row lasts
until a test or a run of the experiment is added or removed.
"""

SWEEPS = Table("sweeps", TABLES, *_columns(SweepRecord, key="sweep", without=("trials",)))
"""A search over the settings of a spec: the fields of SweepRecord. `folder` is stored as that of a run."""

TRIALS = Table("trials", TABLES, _part_of_key("sweep", _owner("sweeps.sweep")), *_columns(Trial, key="number"))
"""One trial of a sweep: the settings it drew, its runs (one per seed) and its objectives."""
