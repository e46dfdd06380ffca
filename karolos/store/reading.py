"""Finding runs in the index, as they are now."""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

from sqlalchemy import Connection, Select, select

from ..errors import RunError
from ..records import RunFolder
from ..records.run_records import UNFINISHED, RunSummary
from ..registry import closest
from .filters import Filter
from .rows import ROWS_PER_STATEMENT, SUMMARY_COLUMNS, chunks, summary_of, where_it_lies
from .tables import PARAMETERS, RUNS, TAGS, VERSIONS

_PACKAGE = "versions."
_FIELDS = (*SUMMARY_COLUMNS, "tags")
_TAGS = select(TAGS.c.run, TAGS.c.tag)
_Getter = Callable[[Any], Any]


class _Value(NamedTuple):
    """How to get the value that a filter's key has for a run."""

    column: str
    """Of a run's row, that it is read from."""
    stored: _Getter
    """As it is stored, something that can be hashed."""
    living: bool
    """Whether to ask the run as it is now for it, else its row."""
    meaning: _Getter
    """From what is stored to the value."""


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
        asked = self._asked(condition) if condition else {}
        fields = {"run", "state", *(value.column for value in asked.values())}
        rows = self._connection.execute(query.with_only_columns(*(RUNS.c[name] for name in sorted(fields)))).all()
        unfinished = self._named(query, [row.run for row in rows if row.state in UNFINISHED])
        fits = _remembered(condition, asked) if condition else None
        fitting = []
        for row in rows:
            now = unfinished.get(row.run, row)
            if (state is None or state == now.state) and (fits is None or fits(row, now)):
                fitting.append(row.run)
                if len(fitting) == limit:
                    break
        found = self._named(query, [run for run in fitting if run not in unfinished]) | unfinished
        return tuple(found[run] for run in fitting)

    def _named(self, query: Select[Any], runs: Sequence[str]) -> dict[str, RunSummary]:
        """Runs by their ids, as they are now."""
        found: dict[str, RunSummary] = {}
        for portion in chunks(runs):
            rows = self._connection.execute(query.where(RUNS.c.run.in_(portion))).all()
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
        return self._grouped(_TAGS.where(TAGS.c.run.in_([row.run for row in rows])))

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

    def _asked(self, condition: Filter) -> dict[str, _Value]:
        """How to get the value of each key that a filter names."""
        asked: dict[str, _Value] = {}
        for key in condition.keys:
            if key in _FIELDS:
                asked[key] = self._field(key)
            elif key.startswith(_PACKAGE):
                if versions := self._versions(key.removeprefix(_PACKAGE)):
                    asked[key] = _Value("software", attrgetter("software"), False, versions.get)
            elif values := self._parameters(key):
                asked[key] = _Value("spec", attrgetter("spec"), False, values.get)
        condition.refuse_unknown(asked.__contains__, self._closest)
        return asked

    def _field(self, key: str) -> _Value:
        if key == "tags":
            tags = self._all_tags()
            return _Value("run", lambda now: tuple(tags.get(now.run, ())), True, _same)
        meaning: dict[str, _Getter] = {"seed": int, "folder": lambda stored: where_it_lies(stored, self._home)}
        return _Value(key, attrgetter(key), True, meaning.get(key, _same))

    def _parameters(self, key: str) -> dict[str, Any]:
        """The values of a setting by the digest of the spec."""
        query = select(PARAMETERS.c.spec, PARAMETERS.c.value).where(PARAMETERS.c.key == key)
        read: dict[str, Any] = {}  # few texts stand in many rows
        return {
            spec: read[text] if text in read else read.setdefault(text, json.loads(text))
            for spec, text in self._connection.execute(query)
        }

    def _versions(self, package: str) -> dict[str, str]:
        """The versions of a package by the digest of the software."""
        query = select(VERSIONS.c.software, VERSIONS.c.version).where(VERSIONS.c.package == package)
        return {row.software: row.version for row in self._connection.execute(query)}

    def _closest(self, key: str) -> str | None:
        known = list(_FIELDS)
        known += self._connection.scalars(select(PARAMETERS.c.key).distinct())
        known += [_PACKAGE + package for package in self._connection.scalars(select(VERSIONS.c.package).distinct())]
        ends = [name for name in known if name.rpartition(".")[2] == key]  # learning_rate for agent.learning_rate
        return ends[0] if len(ends) == 1 else closest(key, known)


def _remembered(condition: Filter, asked: Mapping[str, _Value]) -> Callable[[Any, Any], bool]:
    """Whether a run fits, from its row and the run as it is now; many have the same values and are judged once."""
    values = tuple(asked.values())
    judged: dict[tuple[Any, ...], bool] = {}

    def fits(row: Any, now: Any) -> bool:
        found = tuple([value.stored(now if value.living else row) for value in values])
        if found not in judged:
            meant = {key: value.meaning(one) for (key, value), one in zip(asked.items(), found, strict=True)}
            judged[found] = condition.matches(meant)
        return judged[found]

    return fits


def _same(value: Any) -> Any:
    return value


def stored_parameters(rows: Iterable[Any]) -> dict[str, Any]:
    """Settings by their key paths, from rows of key and value."""
    return {row.key: json.loads(row.value) for row in rows}
