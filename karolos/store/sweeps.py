"""Sweeps in the index: entering, finding and removing them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from sqlalchemy import delete, select

from ..errors import UsageError
from ..records.sweep_records import SweepRecord
from ..registry import closest
from .database import Database
from .rows import as_stored, folder_path, put, valid
from .tables import SWEEPS, TRIALS

_LISTED = 5


class Sweeps:
    """The sweeps of a results database; get it from `Store.sweeps`."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, records: Sequence[SweepRecord]) -> None:
        """Enter sweeps with all their trials in one transaction; replace those stored."""
        with self._database.writing() as connection:
            for record in records:
                # Deleting a sweep deletes its trials.
                connection.execute(delete(SWEEPS).where(SWEEPS.c.sweep == record.sweep))
                row = {name: getattr(record, name) for name in SWEEPS.c.keys()}  # noqa: SIM118  (not a dictionary)
                row["folder"] = as_stored(record.folder, self._database.home)
                put(connection, SWEEPS, [row | {"final": record.final and asdict(record.final)}])
                put(connection, TRIALS, [{"sweep": record.sweep, **trial.row()} for trial in record.trials])

    def remove(self, sweeps: Sequence[str]) -> None:
        """Remove sweeps from the index by their ids; their runs and folders stay."""
        with self._database.writing() as connection:
            for sweep in sweeps:
                connection.execute(delete(SWEEPS).where(SWEEPS.c.sweep == sweep))

    def all(self, *, name: str | None = None) -> tuple[SweepRecord, ...]:
        """Sweeps with their trials, the newest first; `name` keeps those of this name or id."""
        query = select(SWEEPS).order_by(SWEEPS.c.created.desc(), SWEEPS.c.sweep.desc())
        trials = select(TRIALS).order_by(TRIALS.c.number)
        if name is not None:
            query = query.where((SWEEPS.c.name == name) | (SWEEPS.c.sweep == name))
        with self._database.reading() as connection:
            rows = connection.execute(query).all()
            if name is not None:
                trials = trials.where(TRIALS.c.sweep.in_([row.sweep for row in rows]))
            grouped: dict[str, list[Any]] = defaultdict(list)
            for row in connection.execute(trials):
                grouped[row.sweep].append(row._asdict())
        found = []
        for row in rows:
            below = {"folder": folder_path(row.folder, self._database.home), "trials": grouped[row.sweep]}
            found.append(valid(SweepRecord, row._asdict() | below, f"sweep {row.sweep}"))
        return tuple(found)

    def find(self, name: str) -> SweepRecord:
        """The one sweep of this name or id.

        Raises:
            UsageError: there is none, or several folders hold one of this name.
        """
        found = self.all(name=name)
        if not found:
            like = closest(name, {record.name for record in self.all()})
            hint = "`karolos sweeps list` shows them"
            raise UsageError(f"there is no sweep {name!r}", hint=f"did you mean {like!r}? {hint}" if like else hint)
        if len(found) > 1:
            listed = ", ".join(record.sweep for record in found[:_LISTED])
            raise UsageError(f"{name!r} means several sweeps", hint=f"one of {listed}")
        return found[0]
