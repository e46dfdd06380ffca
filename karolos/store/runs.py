"""Finding runs in the index, with their current state."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, TypedDict, Unpack

from sqlalchemy import Connection, Select, func, select

from ..errors import RunError, UsageError
from ..records import RunFolder
from ..records.results import TestCounts
from ..records.run_records import STATES, UNFINISHED, RunRecord, RunSummary, flatten
from ..registry import alternatives, closest
from . import filters
from .database import Database
from .filters import Filter
from .rows import SUMMARY_FIELDS, folder_path, summary_of
from .tables import RUNS, SOFTWARE, SPECS, TESTS, TRIALS

MOST_NAMED = 500
"""A query names at most this many runs; for more, all rows are read."""
_PACKAGE, _MEASURE = "versions.", "measures."


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
    (agent.learning_rate), versions.<package>, and the means of measures (measures.peak_force)."""
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
    state, where, limit = conditions.get("state"), conditions.get("where"), conditions.get("limit")
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
        if state is None and condition is None:
            return _summaries(connection, query.limit(limit), database.home)
        unfinished_runs = _summaries(connection, query.where(RUNS.c.state.in_(UNFINISHED)), database.home)
        unfinished = {run.run: run for run in unfinished_runs}
        values = _Values(connection, database.home).of(condition) if condition else {}
        # Only the columns in the filter are read of all runs: most of ten thousand do not match.
        columns = [column for column, _ in values.values()]

        def holds(stored: tuple[Any, ...]) -> bool:
            found = {key: get(one) for (key, (_, get)), one in zip(values.items(), stored, strict=True)}
            return condition is None or condition.matches(found)

        judge = holds if {"tags", "measures"}.intersection(columns) else cache(holds)  # no cache holds lists or objects
        matching: list[str] = []
        for run, indexed, *row in connection.execute(
            query.with_only_columns(RUNS.c.run, RUNS.c.state, *(RUNS.c[name] for name in columns))
        ):
            current = unfinished.get(run)
            stored = (getattr(current, name, one) for name, one in zip(columns, row, strict=True)) if current else row
            if state in (None, current.state if current else indexed) and judge(tuple(stored)):
                matching.append(run)
                if len(matching) == limit:
                    break
        if len(matching) <= MOST_NAMED:
            query = query.where(RUNS.c.run.in_(matching))
        known = {run.run: run for run in _summaries(connection, query, database.home)} | unfinished
        return tuple(known[run] for run in matching)


def records_of(database: Database, runs: Sequence[RunSummary]) -> tuple[RunRecord, ...]:
    """Everything that the index has of these runs, in their order."""
    names = [run.run for run in runs]
    query = select(RUNS.c.run, SPECS.c.content, SOFTWARE.c.content).join(SPECS).join(SOFTWARE)
    counts = select(TESTS).order_by(TESTS.c.run, TESTS.c.steps)
    if len(names) <= MOST_NAMED:
        query, counts = query.where(RUNS.c.run.in_(names)), counts.where(TESTS.c.run.in_(names))
    tests: dict[str, list[TestCounts]] = defaultdict(list)
    with database.reading() as connection:
        contents = {run: (spec, software) for run, spec, software in connection.execute(query)}
        for run, *numbers in connection.execute(counts):
            tests[run].append(TestCounts(*numbers))
    known = [run for run in runs if run.run in contents]  # one may be removed meanwhile
    return tuple(RunRecord(run, contents[run.run][0], tuple(tests[run.run]), contents[run.run][1]) for run in known)


def closest_value(database: Database, where: str) -> str | None:
    """For a filter that matches no run: the first value in it that no run has, and the closest that some run has."""
    condition = filters.parse(where)
    with database.reading() as connection:
        values = _Values(connection, database.home)
        for comparison in condition.comparisons:
            for literal in comparison.literals if comparison.operator in ("=", "in") else ():
                known = values.texts(comparison.key)
                like = None if literal.text in known else closest(literal.text, known)
                if like is not None and isinstance(literal.value, str):
                    return f"no run has {comparison.key}={literal.text}, did you mean {like}?"
    return None


_Value = tuple[str, Callable[[Any], Any]]
"""The column of `runs` to read for a filter's key, a field of RunSummary or a digest, and how to get its value."""


class _Values:
    """The values of filters' keys, as one transaction sees them.

    Args:
        connection: of a transaction that reads.
        home: the database's folder.
    """

    def __init__(self, connection: Connection, home: Path | None) -> None:
        self._connection = connection
        self._home = home

    def of(self, condition: Filter) -> dict[str, _Value]:
        """How to get the value of each key of a filter. Raises UsageError for a key that no run has."""
        found = {key: self._value(key) for key in condition.keys}
        condition.refuse_unknown(lambda key: found[key] is not None, self._closest)
        return {key: value for key, value in found.items() if value is not None}

    def texts(self, key: str) -> set[str]:
        """The distinct texts that runs have as the value of a key."""
        if key == "tags":
            return {tag for tags in self._connection.scalars(select(RUNS.c.tags)) for tag in tags}
        if key in SUMMARY_FIELDS:
            return {text for text in self._connection.scalars(select(RUNS.c[key]).distinct()) if isinstance(text, str)}
        return {text for text in self._settings(key).values() if isinstance(text, str)}

    def _value(self, key: str) -> _Value | None:
        if key in SUMMARY_FIELDS:
            decode: dict[str, Callable[[Any], Any]] = {"seed": int, "folder": lambda one: folder_path(one, self._home)}
            return key, decode.get(key, lambda one: one)
        if (measure := key.removeprefix(_MEASURE)) != key:
            return ("measures", lambda one: one.get(measure, {}).get("mean")) if measure in self._measures else None
        if (package := key.removeprefix(_PACKAGE)) != key:
            versions = {name: content[package] for name, content in self._software.items() if package in content}
            return ("software", versions.get) if versions else None
        settings = self._settings(key)
        return ("spec", settings.get) if settings else None

    def _settings(self, key: str) -> dict[str, Any]:
        """The values of a setting by the digest of the spec."""
        found = ((name, list(flatten(spec, only=key))) for name, spec in self._specs.items())
        return {name: values[0][1] for name, values in found if values}

    @cached_property
    def _specs(self) -> dict[str, dict[str, Any]]:
        """The specs by digest."""
        return dict(iter(self._connection.execute(select(SPECS))))

    @cached_property
    def _software(self) -> dict[str, dict[str, str]]:
        """The versions of packages, by digest."""
        return dict(iter(self._connection.execute(select(SOFTWARE))))

    @cached_property
    def _measures(self) -> set[str]:
        """The names of the measures that runs have."""
        return {name for measures in self._connection.scalars(select(RUNS.c.measures)) for name in measures}

    def _closest(self, key: str) -> str | None:
        known = {*SUMMARY_FIELDS, *(_PACKAGE + package for content in self._software.values() for package in content)}
        known.update(_MEASURE + measure for measure in self._measures)
        known.update(key for spec in self._specs.values() for key, _ in flatten(spec))
        endings = [name for name in known if name.rpartition(".")[2] == key]  # learning_rate for agent.learning_rate
        return endings[0] if len(endings) == 1 else closest(key, known)


def _summaries(connection: Connection, query: Select[Any], home: Path | None) -> tuple[RunSummary, ...]:
    found = (summary_of(row, home) for row in connection.execute(query))
    return tuple(_current(run) if run.state in UNFINISHED else run for run in found)


def _current(indexed: RunSummary) -> RunSummary:
    """The current state of a run that is unfinished in the index."""
    if not os.path.isdir(indexed.folder):
        return indexed
    try:
        folder = RunFolder.open(indexed.folder)
        return indexed if folder.is_locked() else folder.summary()
    except RunError:
        return replace(indexed, state="lost")
