"""Finding runs in the index, with their current state."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import NoneType
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
from .rows import SUMMARY_FIELDS, folder_path, means, summary_of
from .tables import RUNS, SOFTWARE, SPECS, TESTS, TRIALS

NUMBERS = {int, float, NoneType}
"""Types of the values of what is a number, or missing."""
MOST_NAMED = 500
"""A query names at most this many runs; for more, all rows are read."""


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
        UsageError: the state is unknown, or the filter cannot be read, names what no run has, or compares a number
            with a text.
    """
    state, where, limit = conditions.get("state"), conditions.get("where"), conditions.get("limit")
    if state is not None and state not in STATES:
        raise UsageError(f"there is no state {state!r}", hint=alternatives(state, STATES, what="states"))
    condition = filters.parse(where) if where is not None else None
    query = select(RUNS).order_by(RUNS.c.created.desc(), RUNS.c.run.desc())
    if state is not None:  # an unfinished one may be in any state by now
        query = query.where(RUNS.c.state.in_((state, *UNFINISHED)))
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
            return summaries(connection, query.limit(limit), database.home)
        kept = _matching(connection, condition, database.home) if condition else None
        matching: list[RunSummary] = []
        for row in connection.execute(query):
            if kept is not None and row.run not in kept:
                continue
            run = _summary(row, database.home)
            if state in (None, run.state):
                matching.append(run)
                if len(matching) == limit:
                    break
        return tuple(matching)


def matching_runs(database: Database, where: str) -> set[str]:
    """The ids of the runs that match a filter, of which only what the filter names is read. Raises as `find_runs`."""
    condition = filters.parse(where)
    with database.reading() as connection:
        return _matching(connection, condition, database.home)


def _matching(connection: Connection, condition: Filter, home: Path | None) -> set[str]:
    shared = _shared_values(connection, condition)
    named = condition.keys & set(SUMMARY_FIELDS)
    measured = any(key.startswith("measures") for key in condition.keys)
    unfinished = select(RUNS).where(RUNS.c.state.in_(UNFINISHED))
    current = {run.run: run for run in summaries(connection, unfinished, home)}
    columns = [RUNS.c[name] for name in sorted({"run", "spec", "software", *named, *["measures"] * measured})]
    found: set[str] = set()
    kinds: dict[str, set[type]] = defaultdict(set)
    for row in connection.execute(select(*columns)).mappings():
        own: Any = vars(current[row["run"]]) if row["run"] in current else row
        values = shared.get(row["spec"], {}) | shared.get(row["software"], {})
        if measured:
            values |= means(own["measures"])
        values |= {name: own[name] for name in named}
        if "folder" in named:
            values["folder"] = folder_path(own["folder"], home)
        for key, value in values.items():
            kinds[key].add(type(value))
        if condition.matches(values):
            found.add(row["run"])
    condition.refuse_texts({key for key, types in kinds.items() if types != {NoneType} and types <= NUMBERS})
    return found


def records_of(database: Database, runs: Sequence[RunSummary]) -> tuple[RunRecord, ...]:
    """Everything that the index has of these runs, in their order. Of unfinished ones it reads the folders' tests."""
    names = [run.run for run in runs]
    query = select(RUNS.c.run, RUNS.c.state, SPECS.c.content, SOFTWARE.c.content).join(SPECS).join(SOFTWARE)
    counts = select(TESTS).order_by(TESTS.c.run, TESTS.c.steps)
    if len(names) <= MOST_NAMED:
        query, counts = query.where(RUNS.c.run.in_(names)), counts.where(TESTS.c.run.in_(names))
    tests: dict[str, list[TestCounts]] = defaultdict(list)
    with database.reading() as connection:
        contents = {run: content for run, *content in connection.execute(query)}
        for run, *numbers in connection.execute(counts):
            tests[run].append(TestCounts(*numbers))
    known = [run for run in runs if run.run in contents]  # one may be removed meanwhile
    found = []
    for run in known:
        state, spec, software = contents[run.run]
        if state in UNFINISHED:  # it may have gone on without the process that indexed it
            with suppress(RunError):  # without its folder the index is all there is
                tests[run.run] = list(RunFolder.open(run.folder).record().tests)
        found.append(RunRecord(run, spec, tuple(tests[run.run]), software))
    return tuple(found)


def _shared_values(connection: Connection, condition: Filter) -> dict[str, dict[str, Any]]:
    """Digest of a spec or of software -> its values by those keys of the filter that are no fields of runs.

    Raises UsageError if the filter names what no run has.
    """
    wanted = condition.keys.difference(SUMMARY_FIELDS)
    found: dict[str, dict[str, Any]] = {}
    known = set(SUMMARY_FIELDS)
    if wanted:
        found = {name: dict(flatten(spec)) for name, spec in connection.execute(select(SPECS))}
        for name, versions in connection.execute(select(SOFTWARE)):
            found[name] = {f"versions.{package}": version for package, version in versions.items()}
        measures = map(means, connection.scalars(select(RUNS.c.measures)))
        known.update(*found.values(), *measures)

    def like(key: str) -> str | None:
        endings = [name for name in known if name.rpartition(".")[2] == key]  # learning_rate for agent.learning_rate
        return endings[0] if len(endings) == 1 else closest(key, known)

    condition.refuse_unknown(known.__contains__, like)
    return {name: {key: values[key] for key in wanted & values.keys()} for name, values in found.items()}


def summaries(connection: Connection, query: Select[Any], home: Path | None) -> tuple[RunSummary, ...]:
    return tuple(_summary(row, home) for row in connection.execute(query))


def _summary(row: Any, home: Path | None) -> RunSummary:
    run = summary_of(row, home)
    return _current(run) if run.state in UNFINISHED else run


def _current(indexed: RunSummary) -> RunSummary:
    """The current state of a run that is unfinished in the index, and how far it is."""
    if not os.path.isdir(indexed.folder):
        return indexed
    try:
        folder = RunFolder.open(indexed.folder)
        if not folder.is_locked():
            return folder.summary()
        now, progress = folder.state(), ("steps", "seconds", "updates", "total_seconds", "updated")
        return replace(indexed, **{name: getattr(now, name) for name in progress})
    except RunError:
        return replace(indexed, state="lost")
