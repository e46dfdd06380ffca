"""From 2 to 3: sweeps and trials as their folders tell of them. Nothing was ever entered into those of version 2.

A reindex fills them.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic.operations import Operations


def migrate(operations: Operations) -> None:
    operations.drop_table("trials")
    operations.drop_table("sweeps")
    column, text = sa.Column, sa.Text
    operations.create_table(
        "sweeps",
        column("sweep", sa.String(200), primary_key=True),
        column("name", sa.String(64), nullable=False, index=True),
        column("experiment", sa.String(128), nullable=False),
        *(column(name, sa.JSON, nullable=False) for name in ("objectives", "directions", "parameters", "seeds")),
        column("asked", sa.Integer, nullable=False),
        column("wants_final", sa.Boolean, nullable=False),
        column("created", sa.String(32), nullable=False),
        column("folder", text, nullable=False),
        column("final", sa.JSON),
    )
    operations.create_table(
        "trials",
        column("sweep", sa.String(200), sa.ForeignKey("sweeps.sweep", ondelete="CASCADE"), primary_key=True),
        column("number", sa.Integer, primary_key=True, autoincrement=False),
        column("name", sa.String(64), nullable=False),
        column("state", sa.String(16), nullable=False),
        column("drawn", sa.JSON, nullable=False),
        column("values", sa.JSON),
        column("runs", sa.JSON, nullable=False),
        column("error", text),
    )
