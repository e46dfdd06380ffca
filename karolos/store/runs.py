"""Finding runs in the index, with their current state."""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, TypedDict, Unpack

from sqlalchemy import Connection, Select, func, select

from ..errors import RunError, UsageError
from ..records import RunFolder
from ..records.run_records import STATES, UNFINISHED, RunSummary
from ..registry import alternatives, closest
from . import filters
from .database import Database
from .filters import Filter
from .rows import ROWS_PER_STATEMENT, SUMMARY_COLUMNS, chunks, folder_path, summary_of
from .tables import PARAMETERS, RUNS, TAGS, TRIALS, VERSIONS

_PACKAGE = "versions."
_FIELDS = (*SUMMARY_COLUMNS, "tags")
_TAGS = select(TAGS.c.run, TAGS.c.tag)
_Getter = Callable[[Any], Any]


class RunConditions(TypedDict, total=False):
    """Conditions on runs; a condition that is missing or None always holds."""

    ids: Sequence[str] | None
    """Only these runs."""
    prefix: str | None
    """Only runs whose id begins with this."""
    experiment: str | None
    """Only runs whose experiment's hash begins with this."""
    name: str | None
    """Only runs of experiments of this name."""
    state: str | None
    """Only runs in this state, `lost` included."""
    where: str | None
    """A filter (`karolos.store.filters`) over the fields of RunSummary, the settings of the spec by their key paths
    (agent.learning_rate), and versions.<package>."""
    trials: bool | None
    """Only runs of sweeps' trials, or only other runs."""
    limit: int | None
    """At most this many runs."""


def find_runs(database: Database, **conditions: Unpack[RunConditions]) -> tuple[RunSummary, ...]:
    """Runs that meet all conditions (`RunConditions`), the newest first.

    If the index says that a run is unfinished and no process runs it, the state is read from its folder: `lost`, or an
    end that was not indexed.

    Raises:
        UsageError: the state is unknown, or the filter cannot be read or names what no run has.
    """
    state, where = conditions.get("state"), conditions.get("where")
    if state is not None and state not in STATES:
        raise UsageError(f"there is no state {state!r}", hint=alternatives(state, STATES, what="states"))
    condition = filters.parse(where) if where is not None else None
    query = select(RUNS).order_by(RUNS.c.created.desc(), RUNS.c.run.desc())
    for column, prefix in ((RUNS.c.run, conditions.get("prefix")), (RUNS.c.experiment, conditions.get("experiment"))):
        if prefix is not None:
            query = query.where(func.substr(column, 1, len(prefix)) == prefix)  # LIKE may ignore case
    if (name := conditions.get("name")) is not None:
        query = query.where(RUNS.c.name == name)
    if (ids := conditions.get("ids")) is not None:
        query = query.where(RUNS.c.run.in_(ids))
    if (trials := conditions.get("trials")) is not None:
        of_trial = RUNS.c.name.in_(select(TRIALS.c.name))
        query = query.where(of_trial if trials else ~of_trial)
    with database.reading() as connection:
        return _Snapshot(connection, database.home).find(query, state, condition, conditions.get("limit"))


def closest_value(database: Database, where: str) -> str | None:
    """For a filter that matches no run: the first value in it that no run has, and the closest that some run has."""
    condition = filters.parse(where)
    with database.reading() as connection:
        snapshot = _Snapshot(connection, database.home)
        for comparison in condition.comparisons:
            for literal in comparison.literals if comparison.operator in ("=", "in") else ():
                known = snapshot.texts(comparison.key)
                like = None if literal.text in known else closest(literal.text, known)
                if like is not None and isinstance(literal.value, str):
                    return f"no run has {comparison.key}={literal.text}, did you mean {like}?"
    return None


class _Value(NamedTuple):
    """How to get the value of a filter's key for a run."""

    column: str
    """The column of the run's row to read."""
    stored: _Getter
    """The stored value from a row or a RunSummary; hashable."""
    current: bool
    """Whether to read the run's current state if it is unfinished, else its row."""
    decode: _Getter
    """The value from the stored one."""


class _Snapshot:
    """The runs as one transaction sees them.

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
        """The rows of `runs` in the query that have a state and match a filter, as runs.

        Raises:
            UsageError: the filter names what no run has.
        """
        if state is None and condition is None:
            return self._summaries(self._connection.execute(query.limit(limit)).all())
        # Only the columns in the filter are read of all runs: most of ten thousand do not match.
        values = self._values(condition) if condition else {}
        columns = {"run", "state", *(value.column for value in values.values())}
        rows = self._connection.execute(query.with_only_columns(*(RUNS.c[name] for name in sorted(columns)))).all()
        unfinished = self._by_id(query, [row.run for row in rows if row.state in UNFINISHED])
        matches = _cached_matches(condition, values) if condition else None
        matching = []
        for row in rows:
            current = unfinished.get(row.run, row)
            if (state is None or state == current.state) and (matches is None or matches(row, current)):
                matching.append(row.run)
                if len(matching) == limit:
                    break
        found = self._by_id(query, [run for run in matching if run not in unfinished]) | unfinished
        return tuple(found[run] for run in matching)

    def _by_id(self, query: Select[Any], runs: Sequence[str]) -> dict[str, RunSummary]:
        found: dict[str, RunSummary] = {}
        for portion in chunks(runs):
            rows = self._connection.execute(query.where(RUNS.c.run.in_(portion))).all()
            found |= {run.run: run for run in self._summaries(rows)}
        return found

    def _summaries(self, rows: Sequence[Any]) -> tuple[RunSummary, ...]:
        few = len(rows) <= ROWS_PER_STATEMENT
        tags = self._tags(_TAGS.where(TAGS.c.run.in_([row.run for row in rows])) if few else _TAGS)
        indexed = (summary_of(row, tags.get(row.run, ()), self._home) for row in rows)
        return tuple(_current(run) if run.state in UNFINISHED else run for run in indexed)

    def _tags(self, query: Select[str, str]) -> Mapping[str, Sequence[str]]:
        tags: dict[str, list[str]] = defaultdict(list)
        for run, tag in self._connection.execute(query):
            tags[run].append(tag)
        return tags

    def _values(self, condition: Filter) -> dict[str, _Value]:
        """How to get the value of each key of a filter."""
        values: dict[str, _Value] = {}
        for key in condition.keys:
            if key in _FIELDS:
                values[key] = self._field(key)
            elif key.startswith(_PACKAGE):
                if versions := self._versions(key.removeprefix(_PACKAGE)):
                    values[key] = _Value("software", attrgetter("software"), False, versions.get)
            elif settings := self._settings(key):
                values[key] = _Value("spec", attrgetter("spec"), False, settings.get)
        condition.refuse_unknown(values.__contains__, self._closest)
        return values

    def _field(self, key: str) -> _Value:
        if key == "tags":
            tags = self._tags(_TAGS)
            return _Value("run", lambda run: tuple(tags.get(run.run, ())), True, _identity)
        decode: dict[str, _Getter] = {"seed": int, "folder": lambda stored: folder_path(stored, self._home)}
        return _Value(key, attrgetter(key), True, decode.get(key, _identity))

    def texts(self, key: str) -> set[str]:
        """The distinct texts that runs have as the value of a filter's key."""
        if key == "tags":
            return set(self._connection.scalars(select(TAGS.c.tag).distinct()))
        if key in SUMMARY_COLUMNS:
            return {text for text in self._connection.scalars(select(RUNS.c[key]).distinct()) if isinstance(text, str)}
        return {text for text in self._settings(key).values() if isinstance(text, str)}

    def _settings(self, key: str) -> dict[str, Any]:
        """The values of a setting by the digest of the spec."""
        query = select(PARAMETERS.c.spec, PARAMETERS.c.value).where(PARAMETERS.c.key == key)
        parsed: dict[str, Any] = {}  # many rows hold the same text
        return {
            spec: parsed[text] if text in parsed else parsed.setdefault(text, json.loads(text))
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
        endings = [name for name in known if name.rpartition(".")[2] == key]  # learning_rate for agent.learning_rate
        return endings[0] if len(endings) == 1 else closest(key, known)


def _current(indexed: RunSummary) -> RunSummary:
    """The current state of a run that is unfinished in the index."""
    if not os.path.isdir(indexed.folder):
        return indexed
    try:
        folder = RunFolder.open(indexed.folder)
        return indexed if folder.is_locked() else folder.summary()
    except RunError:
        return replace(indexed, state="lost")


def _cached_matches(condition: Filter, values: Mapping[str, _Value]) -> Callable[[Any, Any], bool]:
    """Whether a run matches, from its row and its current state; runs with equal values are judged once."""
    getters = tuple(values.values())
    judged: dict[tuple[Any, ...], bool] = {}

    def matches(row: Any, current: Any) -> bool:
        stored = tuple([value.stored(current if value.current else row) for value in getters])
        if stored not in judged:
            decoded = {key: value.decode(one) for (key, value), one in zip(values.items(), stored, strict=True)}
            judged[stored] = condition.matches(decoded)
        return judged[stored]

    return matches


def _identity(value: Any) -> Any:
    return value
