"""Store: the index over all runs. The run folders are the truth; `reindex` rebuilds the index from them."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from pathlib import Path
from types import NoneType
from typing import Any

from sqlalchemy import Connection, Select, Table, bindparam, delete, func, select, update

from ..errors import RunError, StoreError, UsageError, alternatives, closest
from ..records import RunFolder, labels
from ..records.evaluation import COUNTS, Evaluation
from ..records.run_records import STATES, UNFINISHED, RunRecord, RunSummary, flatten, without_seeds
from ..records.sweep_records import is_trial
from . import filters
from .database import Database, sqlite_url
from .filters import Filter
from .tables import (
    RUNS,
    SOFTWARE,
    SPECS,
    SUCCESSES,
    SUMMARY_FIELDS,
    TESTS,
    as_stored,
    digest,
    folder_path,
    means,
    put,
    summary_of,
)

FILE_NAME = "karolos.sqlite"
NUMBERS = {int, float, NoneType}
"""Types of fields that are numbers or missing."""
MOST_NAMED = 500
"""A query names at most this many runs; for more, all rows are read."""


@contextmanager
def behind(done: str) -> Iterator[None]:
    """Add `done`, the change that a run's folder already has, to the hint of a StoreError of the block."""
    try:
        yield
    except StoreError as error:
        error.hint = f"{f'{error.hint}; ' if error.hint else ''}{done}, and `karolos db reindex` enters this"
        raise


class Store(Database):
    """The results database. Safe for many processes at once; give each its own Store.

    Arguments, attributes and errors are those of Database. `reindex` enters the runs into a new or upgraded one.
    """

    @staticmethod
    def default_url(runs: str | Path) -> str:
        """URL of the database in a runs folder."""
        return sqlite_url(Path(runs) / FILE_NAME)

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add_records(self, records: Sequence[RunRecord]) -> None:
        """Enter runs with all their tests in one transaction. For stored runs only changes are written."""
        contents: dict[Table, dict[str, Mapping[str, Any]]] = {SPECS: {}, SOFTWARE: {}}
        rows = []
        with self.writing() as connection:
            for record in records:
                folder, spec = Path(record.summary.folder), without_seeds(record.spec)
                shared = {"spec": digest(spec), "software": digest(record.versions)}
                contents[SPECS][shared["spec"]], contents[SOFTWARE][shared["software"]] = spec, record.versions
                # Read inside the transaction: the last writer has read everything that was written before.
                current = asdict(labels.read(folder)) if folder.is_dir() else {}
                row = record.summary.row() | {"folder": as_stored(record.summary.folder, self.home)}
                row |= {"commit": record.commit, "trial": is_trial(record.summary)}
                rows.append(row | current | shared)
            for table, values in contents.items():
                shared_rows = [{"digest": name, "content": value} for name, value in values.items()]
                put(connection, table, shared_rows, replace_old=False)
            stored = connection.execute(select(RUNS.c.run, RUNS.c.name).where(_named(RUNS, records)))
            names: dict[str, str] = dict(iter(stored))
            put(connection, RUNS, rows)
            retested = _put_tests(connection, records)
            stale = {
                summary.experiment
                for summary in (record.summary for record in records)
                if summary.run in retested or names.get(summary.run) != summary.name
            }
            _for_each(connection, delete(SUCCESSES).where(SUCCESSES.c.experiment == bindparam("one")), stale)

    def refresh_labels(self, folder: RunFolder) -> None:
        """Copy a run's tags and note from its folder. Raises StoreError if the run is not in the database."""
        change = update(RUNS).where(RUNS.c.run == folder.id).values(asdict(folder.labels()))
        with behind(f"the folder of {folder.id} has its new tags and note"), self.writing() as connection:
            if not connection.execute(change).rowcount:
                raise StoreError(f"the run {folder.id} is not in the database", where=self.name)

    def remove_runs(self, runs: Sequence[str]) -> None:
        """Remove runs from the index, with their tests and everything that only they use. Folders stay."""
        experiment = select(RUNS.c.experiment).where(RUNS.c.run == bindparam("one")).scalar_subquery()
        with self.writing() as connection:
            _for_each(connection, delete(SUCCESSES).where(SUCCESSES.c.experiment == experiment), runs)
            _for_each(connection, delete(RUNS).where(RUNS.c.run == bindparam("one")), runs)
            for digests, references in ((SPECS.c.digest, RUNS.c.spec), (SOFTWARE.c.digest, RUNS.c.software)):
                used = select(references).where(references == digests).exists()
                connection.execute(delete(digests.table).where(~used))

    def runs(
        self,
        *,
        ids: Sequence[str] | None = None,
        prefix: str | None = None,
        experiment: str | None = None,
        name: str | None = None,
        state: str | None = None,
        where: str | None = None,
        trials: bool | None = None,
        limit: int | None = None,
    ) -> tuple[RunSummary, ...]:
        """Runs that meet all conditions, the newest first.

        If the index says that a run is unfinished and no process runs it, the state is read from its folder: `lost`, or
        an end that was not indexed. `prefix` is the beginning of an id, `experiment` that of a hash. `trials` are runs
        of sweeps' trials: only these, or none of them.

        `where` is a filter (`karolos.store.filters`) over the fields of RunSummary, the settings of the spec by their
        key paths (agent.learning_rate), versions.<package>, and the means of measures (measures.peak_force).

        Raises UsageError if the state is unknown, or the filter cannot be read, names what no run has, or compares a
        number with a text.
        """
        if state is not None and state not in STATES:
            raise UsageError(f"there is no state {state!r}", hint=alternatives(state, STATES, what="states"))
        condition = filters.parse(where) if where is not None else None
        query = select(RUNS).order_by(RUNS.c.created.desc(), RUNS.c.run.desc())
        if state is not None:  # an unfinished one may be in any state by now
            query = query.where(RUNS.c.state.in_((state, *UNFINISHED)))
        for column, beginning in ((RUNS.c.run, prefix), (RUNS.c.experiment, experiment)):
            if beginning is not None:
                query = query.where(func.substr(column, 1, len(beginning)) == beginning)  # LIKE may ignore case
        if name is not None:
            query = query.where(RUNS.c.name == name)
        if ids is not None:
            query = query.where(RUNS.c.run.in_(ids))
        if trials is not None:
            query = query.where(RUNS.c.trial == trials)
        with self.reading() as connection:
            if state is None and condition is None:
                return summaries(connection, query.limit(limit), self.home)
            kept = _matching(connection, condition, self.home) if condition else None
            matching: list[RunSummary] = []
            for row in connection.execute(query):
                if kept is not None and row.run not in kept:
                    continue
                run = _summary(row, self.home)
                if state in (None, run.state):
                    matching.append(run)
                    if len(matching) == limit:
                        break
            return tuple(matching)

    def matching(self, where: str) -> set[str]:
        """The ids of the runs that match a filter. Only values that the filter names are read. Raises as `runs`."""
        condition = filters.parse(where)
        with self.reading() as connection:
            return _matching(connection, condition, self.home)

    def records(self, runs: Sequence[RunSummary]) -> tuple[RunRecord, ...]:
        """Everything that the index has of these runs, in order. Unfinished ones have the tests of their folders."""
        names = [run.run for run in runs]
        columns = (RUNS.c.run, RUNS.c.state, RUNS.c.commit, SPECS.c.content, SOFTWARE.c.content)
        query = select(*columns).join(SPECS).join(SOFTWARE)
        counts = select(TESTS).order_by(TESTS.c.run, TESTS.c.steps)
        if len(names) <= MOST_NAMED:
            query, counts = query.where(RUNS.c.run.in_(names)), counts.where(TESTS.c.run.in_(names))
        tests: dict[str, list[Evaluation]] = defaultdict(list)
        with self.reading() as connection:
            contents = {run: content for run, *content in connection.execute(query)}
            for run, *numbers in connection.execute(counts):
                tests[run].append(Evaluation(*numbers))
        known = [run for run in runs if run.run in contents]  # one may be removed meanwhile
        found = []
        for run in known:
            state, commit, spec, software = contents[run.run]
            if state in UNFINISHED:  # it may have continued without the process that indexed it
                with suppress(RunError):  # without its folder the index is all there is
                    tests[run.run] = list(RunFolder.open(run.folder).record().tests)
            found.append(RunRecord(run, spec, tuple(tests[run.run]), software, commit))
        return tuple(found)


def _put_tests(connection: Connection, records: Sequence[RunRecord]) -> set[str]:
    """Replace the stored tests of runs by those of their records; returns the runs whose tests changed."""
    stored: dict[str, dict[int, Evaluation]] = defaultdict(dict)
    for run, steps, *numbers in connection.execute(select(TESTS).where(_named(TESTS, records))):
        stored[run][steps] = Evaluation(steps, *numbers)
    retested, rows = set(), []
    for record in records:
        run, old, new = record.summary.run, stored[record.summary.run], {test.steps: test for test in record.tests}
        if old != new:
            retested.add(run)
            gone = delete(TESTS).where(TESTS.c.run == run, TESTS.c.steps == bindparam("one"))
            _for_each(connection, gone, old.keys() - new.keys())
            changed = [test for steps, test in new.items() if old.get(steps) != test]
            rows += [{"run": run, **{name: getattr(test, name) for name in COUNTS}} for test in changed]
    put(connection, TESTS, rows)
    return retested


def _named(table: Table, records: Sequence[RunRecord]) -> Any:
    """The condition that a row belongs to one of these runs."""
    return table.c.run.in_([record.summary.run for record in records])


def _for_each(connection: Connection, statement: Any, values: Any) -> None:
    """Execute a statement with each of some values as its parameter `one`."""
    if values:
        connection.execute(statement, [{"one": value} for value in values])


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


def _shared_values(connection: Connection, condition: Filter) -> dict[str, dict[str, Any]]:
    """Digest of a spec or of software -> its values, for the keys of the filter that are not fields of runs.

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
    """The current state and progress of a run that is unfinished in the index."""
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
