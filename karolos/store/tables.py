"""Tables of the results database. Times are ISO 8601 text in UTC, which sorts like the time on every database.

The tables are plain: SQLAlchemy's mapper takes longer to import than most queries take.
"""

from __future__ import annotations

from typing import Any

from sqlalchemy import JSON, BigInteger, Boolean, Column, Float, ForeignKey, Integer, MetaData, String, Table, Text
from sqlalchemy.types import TypeEngine

SCHEMA = 7
"""Version of these tables, stored in `karolos_schema`. Raise it with every change of the tables.

A database of another version is refused: the run folders are the truth, and `karolos db reindex` builds a new one.
"""
TABLES = MetaData()


def _column(name: str, kind: TypeEngine[Any], *, index: bool = False) -> Column[Any]:
    """A column that is never null."""
    return Column(name, kind, nullable=False, index=index)


def _part_of_key(name: str, kind: TypeEngine[Any] | ForeignKey, *, index: bool = False) -> Column[Any]:
    return Column(name, kind, primary_key=True, index=index, autoincrement=False)


def _owner(column: str) -> ForeignKey:
    """The row that this row belongs to and is deleted with."""
    return ForeignKey(column, ondelete="CASCADE")


SCHEMA_VERSION = Table("karolos_schema", TABLES, _part_of_key("version", Integer()))
"""One row: the version of the tables. Only a karolos database has this table."""

EXPERIMENTS = Table("experiments", TABLES, _part_of_key("hash", String(128)))
"""Runs of the same hash belong to one experiment: their results may be pooled."""

SPECS = Table("specs", TABLES, _part_of_key("digest", String(64)), _column("spec", JSON()))
"""A resolved spec without its seeds, stored once for all runs that have exactly this one.

Specs of one experiment may differ in what results do not depend on: name, device, threads.
"""

PARAMETERS = Table(
    "parameters",
    TABLES,
    _part_of_key("spec", _owner("specs.digest")),
    _part_of_key("key", Text(), index=True),
    _column("value", Text()),
)
"""One setting of a spec: its key path (agent.learning_rate) and its value as JSON."""

VERSIONS = Table(
    "versions",
    TABLES,
    _part_of_key("software", String(64)),
    _part_of_key("package", String(200)),
    _column("version", Text()),
)
"""One package of the software that a run was made with; `software` is the digest of all of them together."""

RUNS = Table(
    "runs",
    TABLES,
    _part_of_key("run", String(200)),
    Column("experiment", ForeignKey("experiments.hash"), nullable=False, index=True),
    _column("seed", String(64)),  # text: a seed may have more than 64 bits
    _column("state", String(16), index=True),
    _column("steps", BigInteger()),
    _column("seconds", Float(53)),
    Column("success_any", Float(53)),
    Column("success_end", Float(53)),
    Column("steps_to_95", BigInteger()),
    Column("seconds_to_95", Float(53)),
    _column("name", String(64), index=True),
    Column("episodes", Integer()),
    Column("environment", String(128)),
    Column("robot", String(128)),
    Column("task", String(128)),
    Column("agent", String(128)),
    _column("attempt", Integer()),
    Column("error", Text()),
    _column("created", String(32), index=True),
    _column("updated", String(32)),
    _column("folder", Text()),
    Column("note", Text()),
    Column("updates", BigInteger()),
    _column("final", Boolean()),
    Column("best_steps", BigInteger()),
    Column("best_any", Float(53)),
    Column("best_end", Float(53)),
    Column("steps_to_95_any", BigInteger()),
    Column("seconds_to_95_any", Float(53)),
    _column("total_seconds", Float(53)),
    Column("mean_return", Float(53)),
    Column("best_return", Float(53)),
    Column("spec", ForeignKey("specs.digest"), nullable=False, index=True),
    Column("software", String(64), index=True),  # null: not known
)
"""One spec, one seed: the fields of RunSummary. `folder` is relative to the database's own folder below it."""

TAGS = Table(
    "tags",
    TABLES,
    _part_of_key("run", _owner("runs.run")),
    _part_of_key("tag", String(200), index=True),
)
"""A tag that a person gave a run. The run folder holds it, too."""

TESTS = Table(
    "tests",
    TABLES,
    _part_of_key("run", _owner("runs.run")),
    _part_of_key("steps", BigInteger()),
    _column("seconds", Float(53)),
    _column("episodes", Integer()),
    *(Column(name, Integer()) for name in ("successes_any", "successes_end", "solved_at_reset")),  # null: no success
    Column("mean_return", Float(53)),
)
"""One test of a run: the fields of TestCounts. The run folder holds the test episode by episode."""

SUCCESSES = Table(
    "success_summaries",
    TABLES,
    _part_of_key("experiment", _owner("experiments.hash")),
    _part_of_key("counting", String(8)),  # any or end
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

SWEEPS = Table(
    "sweeps",
    TABLES,
    _part_of_key("sweep", String(200)),
    _column("name", String(64), index=True),
    _column("experiment", String(128)),  # not a foreign key: trials have other settings
    *(_column(name, JSON()) for name in ("objectives", "directions", "parameters", "seeds")),
    _column("asked", Integer()),
    _column("wants_final", Boolean()),
    _column("created", String(32)),
    _column("folder", Text()),
    Column("final", JSON(none_as_null=True)),
)
"""A search over the settings of a spec: the fields of SweepRecord. `folder` is stored as that of a run."""

TRIALS = Table(
    "trials",
    TABLES,
    _part_of_key("sweep", _owner("sweeps.sweep")),
    _part_of_key("number", Integer()),
    _column("name", String(64)),
    _column("state", String(16)),
    _column("drawn", JSON()),
    Column("values", JSON(none_as_null=True)),  # one for each objective
    _column("runs", JSON()),  # no foreign key: a run may go to the trash and come back
    Column("error", Text()),
)
"""One trial of a sweep: the settings it drew, its runs (one per seed) and its objectives."""
