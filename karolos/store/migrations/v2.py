"""From 1 to 2: specs by their digest with their settings, software versions, tags, notes, success summaries, sweeps.

What only the run folders know (versions, tags, notes) comes with a reindex.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import Any

import sqlalchemy as sa
from alembic.operations import Operations


def migrate(operations: Operations) -> None:
    _make_tables(operations)
    connection = operations.get_bind()
    with operations.batch_alter_table("runs") as runs:
        runs.add_column(sa.Column("note", sa.Text))
        runs.add_column(sa.Column("spec", sa.String(64)))
        runs.add_column(sa.Column("software", sa.String(64)))
    _move_specs(connection)
    with operations.batch_alter_table("runs") as runs:
        runs.alter_column("spec", existing_type=sa.String(64), nullable=False)
        runs.create_foreign_key("runs_spec_fkey", "specs", ["spec"], ["digest"])
        runs.create_index("ix_runs_spec", ["spec"])
        runs.create_index("ix_runs_software", ["software"])
    with operations.batch_alter_table("experiments") as experiments:
        experiments.drop_index("ix_experiments_name")
        experiments.drop_column("name")
        experiments.drop_column("spec")
    # Experiments of which no run is left: the second schema does not keep them.
    connection.execute(sa.text("DELETE FROM experiments WHERE hash NOT IN (SELECT experiment FROM runs)"))
    connection.execute(sa.text("DELETE FROM parameters WHERE spec NOT IN (SELECT spec FROM runs)"))
    connection.execute(sa.text("DELETE FROM specs WHERE digest NOT IN (SELECT spec FROM runs)"))


def _make_tables(operations: Operations) -> None:
    column, text = sa.Column, sa.Text
    operations.create_table(
        "specs", column("digest", sa.String(64), primary_key=True), column("spec", sa.JSON, nullable=False)
    )
    operations.create_table(
        "parameters",
        column("spec", sa.String(64), sa.ForeignKey("specs.digest", ondelete="CASCADE"), primary_key=True),
        column("key", text, primary_key=True, index=True),
        column("value", text, nullable=False),
    )
    operations.create_table(
        "versions",
        column("software", sa.String(64), primary_key=True),
        column("package", sa.String(200), primary_key=True),
        column("version", text, nullable=False),
    )
    operations.create_table(
        "tags",
        column("run", sa.String(200), sa.ForeignKey("runs.run", ondelete="CASCADE"), primary_key=True),
        column("tag", sa.String(200), primary_key=True, index=True),
    )
    numbers = ("bandwidth", "mode", "mean", "low", "high")
    operations.create_table(
        "success_summaries",
        column("experiment", sa.String(128), sa.ForeignKey("experiments.hash", ondelete="CASCADE"), primary_key=True),
        column("steps", sa.BigInteger, primary_key=True, autoincrement=False),
        column("counting", sa.String(8), primary_key=True),
        column("runs", sa.Integer, nullable=False),
        *(column(name, sa.Float(53), nullable=False) for name in numbers),
        column("modes", sa.JSON, nullable=False),
    )
    operations.create_table(
        "sweeps",
        column("name", sa.String(200), primary_key=True),
        column("spec_hash", sa.String(128), nullable=False),
        column("storage", text, nullable=False),
        column("created", sa.String(32), nullable=False),
    )
    operations.create_table(
        "trials",
        column("sweep", sa.String(200), sa.ForeignKey("sweeps.name", ondelete="CASCADE"), primary_key=True),
        column("number", sa.Integer, primary_key=True, autoincrement=False),
        column("state", sa.String(16), nullable=False),
        column("value", sa.Float(53)),
        column("runs", sa.JSON, nullable=False),
    )


def _move_specs(connection: sa.Connection) -> None:
    experiments = sa.table("experiments", sa.column("hash"), sa.column("spec", sa.JSON))
    specs = sa.table("specs", sa.column("digest"), sa.column("spec", sa.JSON))
    parameters = sa.table("parameters", sa.column("spec"), sa.column("key"), sa.column("value"))
    runs = sa.table("runs", sa.column("experiment"), sa.column("spec"))
    seen: set[str] = set()
    for experiment, spec in connection.execute(sa.select(experiments.c.hash, experiments.c.spec)).all():
        digest = hashlib.sha256(json.dumps(spec, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
        connection.execute(sa.update(runs).where(runs.c.experiment == experiment).values(spec=digest))
        if digest in seen:
            continue
        seen.add(digest)
        connection.execute(sa.insert(specs).values(digest=digest, spec=spec))
        settings = [
            {"spec": digest, "key": key, "value": json.dumps(value)} for key, value in dict(_flatten(spec)).items()
        ]
        if settings:
            connection.execute(sa.insert(parameters), settings)


def _flatten(spec: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in spec.items():
        if isinstance(value, Mapping) and value:
            yield from _flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
