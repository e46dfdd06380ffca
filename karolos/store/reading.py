"""Finding runs in the index, as they are now."""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Select, select

from ..errors import RunError
from ..filters import Filter
from ..registry import closest
from ..run_folder import RunFolder
from ..run_records import UNFINISHED, RunSummary
from .models import ParameterRow, RunRow, TagRow, VersionRow
from .rows import ROWS_PER_STATEMENT, SUMMARY_COLUMNS, chunks, summary_of

VERSIONS = "versions."
_FIELDS = (*SUMMARY_COLUMNS, "tags")
_COLUMNS = frozenset(RunRow.__table__.c.keys())
_TAGS = select(TagRow.run, TagRow.tag)
_Getter = Callable[[Any], Any]


class Index:
    """What one transaction sees of the runs.

    Args:
        connection: of a transaction that reads.
        home: the database's folder.
    """

    def __init__(self, connection: Connection, home: Path | None) -> None:
        self._connection = connection
        self._home = home

    def find(
        self, query: Select[Any], state: str | None, condition: Filter | None, limit: int | None
    ) -> tuple[RunSummary, ...]:
        """Rows of `runs` that are in a state and fit a filter, as runs.

        Raises:
            UsageError: the filter names what no run has.
        """
        if state is None and condition is None:
            return self._as_they_are(self._connection.execute(query.limit(limit)).all())
        # Only what the filter asks about is read of all runs: of ten thousand most do not fit.
        getters = self._getters(condition) if condition else {}
        fields = {RunRow.run.name, RunRow.state.name, RunRow.spec.name, RunRow.software.name, *getters} & _COLUMNS
        narrow = query.with_only_columns(*(RunRow.__table__.c[name] for name in sorted(fields)))
        rows = self._connection.execute(narrow).all()
        unfinished = self._named(query, [row.run for row in rows if row.state in UNFINISHED])
        fitting = []
        for row in rows:
            now = unfinished.get(row.run, row)
            if state is not None and state != now.state:
                continue
            values = {key: get(now if living else row) for key, (get, living) in getters.items()}
            if condition and not condition.matches(values):
                continue
            fitting.append(row.run)
            if len(fitting) == limit:
                break
        found = self._named(query, [run for run in fitting if run not in unfinished]) | unfinished
        return tuple(found[run] for run in fitting)

    def _named(self, query: Select[Any], runs: Sequence[str]) -> dict[str, RunSummary]:
        """Runs by their ids, as they are now."""
        found: dict[str, RunSummary] = {}
        for portion in chunks(runs):
            rows = self._connection.execute(query.where(RunRow.run.in_(portion))).all()
            found |= {run.run: run for run in self._as_they_are(rows)}
        return found

    def _as_they_are(self, rows: Sequence[Any]) -> tuple[RunSummary, ...]:
        tags = self._tags(rows)
        return tuple(
            self._current(row, tags) if row.state in UNFINISHED else summary_of(row, tags.get(row.run, ()), self._home)
            for row in rows
        )

    def _tags(self, rows: Sequence[Any]) -> Mapping[str, Sequence[str]]:
        if len(rows) > ROWS_PER_STATEMENT:
            return self._all_tags()
        return self._grouped(_TAGS.where(TagRow.run.in_([row.run for row in rows])))

    def _all_tags(self) -> Mapping[str, Sequence[str]]:
        return self._grouped(_TAGS)

    def _grouped(self, query: Select[str, str]) -> Mapping[str, Sequence[str]]:
        tags: dict[str, list[str]] = defaultdict(list)
        for run, tag in self._connection.execute(query):
            tags[run].append(tag)
        return tags

    def _current(self, row: Any, tags: Mapping[str, Sequence[str]]) -> RunSummary:
        """The run as it is now, where the index says that it goes on."""
        indexed = summary_of(row, tags.get(row.run, ()), self._home)
        if not os.path.isdir(indexed.folder):
            return indexed
        try:
            opened = RunFolder.open(indexed.folder)
            return indexed if opened.is_locked() else opened.summary()
        except RunError:
            return replace(indexed, state="lost")

    def _getters(self, condition: Filter) -> dict[str, tuple[_Getter, bool]]:
        """How to get the value of each key that a filter names; True: from the run as it is now, else from its row."""
        getters: dict[str, tuple[_Getter, bool]] = {}
        for key in condition.keys:
            if key in _FIELDS:
                getters[key] = (self._field(key), True)
            elif key.startswith(VERSIONS):
                if versions := self._versions(key.removeprefix(VERSIONS)):
                    getters[key] = (_looked_up(versions, "software"), False)
            elif values := self._parameters(key):
                getters[key] = (_looked_up(values, "spec"), False)
        condition.refuse_unknown(getters.__contains__, self._closest)
        return getters

    def _field(self, key: str) -> _Getter:
        home = self._home or Path()
        if key == "tags":
            tags = self._all_tags()
            return lambda now: tuple(tags.get(now.run, ()))
        if key == "seed":  # a text in the database
            return lambda now: int(now.seed)
        if key == "folder":
            return lambda now: str(home / now.folder)
        return attrgetter(key)

    def _parameters(self, key: str) -> dict[str, Any]:
        """The values of a setting by the digest of the spec."""
        query = select(ParameterRow.spec, ParameterRow.value).where(ParameterRow.key == key)
        read: dict[str, Any] = {}  # few texts stand in many rows
        return {
            spec: read[text] if text in read else read.setdefault(text, json.loads(text))
            for spec, text in self._connection.execute(query)
        }

    def _versions(self, package: str) -> dict[str, str]:
        """The versions of a package by the digest of the software."""
        query = select(VersionRow.software, VersionRow.version).where(VersionRow.package == package)
        return {row.software: row.version for row in self._connection.execute(query)}

    def _closest(self, key: str) -> str | None:
        known = list(_FIELDS)
        known += self._connection.scalars(select(ParameterRow.key).distinct())
        known += [VERSIONS + package for package in self._connection.scalars(select(VersionRow.package).distinct())]
        ends = [name for name in known if name.rpartition(".")[2] == key]  # learning_rate for agent.learning_rate
        return ends[0] if len(ends) == 1 else closest(key, known)


def _looked_up(values: Mapping[str, Any], reference: str) -> _Getter:
    return lambda row: values.get(getattr(row, reference))


def stored_parameters(rows: Iterable[Any]) -> dict[str, Any]:
    """Settings by their key paths, from rows of key and value."""
    return {row.key: json.loads(row.value) for row in rows}
