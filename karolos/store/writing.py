"""Entering runs into the index and taking them out; each function works inside a transaction that alone writes."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Table, delete, select, update

from ..records import labels
from ..records.labels import Labels
from ..records.run_records import RunRecord, RunSummary
from .rows import StoredTest, chunks, digest, parameter_rows, put, run_row, upsert, without_seeds
from .tables import EXPERIMENTS, PARAMETERS, RUNS, SPECS, SUCCESSES, TAGS, TESTS, VERSIONS


@dataclass(frozen=True)
class Entry:
    """A run as it is to stand in the index; `tests` None leaves those that are there."""

    summary: RunSummary
    spec: Mapping[str, Any]
    versions: Mapping[str, str] | None
    tests: Sequence[StoredTest] | None

    @classmethod
    def of(cls, record: RunRecord) -> Entry:
        """What a run folder says."""
        run = record.summary.run
        tests = tuple(StoredTest.of(run, result) for result in record.tests)
        return cls(record.summary, record.spec, record.versions, tests)


@dataclass(frozen=True)
class _Shared:
    """What rows of runs refer to, and what goes when no run refers to it any more."""

    experiments: frozenset[str]
    specs: frozenset[str]
    software: frozenset[str]


def enter(connection: Connection, entries: Sequence[Entry], home: Path | None) -> None:
    """Enter runs in place of those that are stored under the same ids."""
    runs = [entry.summary.run for entry in entries]
    before = _shared(connection, runs)
    specs = {digest(spec): spec for spec in (without_seeds(entry.spec) for entry in entries)}
    software = {digest(entry.versions): entry.versions for entry in entries if entry.versions}
    _add_specs(connection, specs)
    _add_software(connection, software)
    experiments = {entry.summary.experiment for entry in entries}
    hashes = [{"hash": name} for name in sorted(experiments)]
    upsert(connection, EXPERIMENTS, hashes, keys=("hash",), replace_old=False)
    written = {entry.summary.run: current_labels(entry.summary) for entry in entries}
    rows = [
        {
            **run_row(entry.summary, home),
            "note": written[entry.summary.run].note,
            "spec": digest(without_seeds(entry.spec)),
            "software": digest(entry.versions) if entry.versions else None,
        }
        for entry in entries
    ]
    upsert(connection, RUNS, rows, keys=("run",))
    _write_tags(connection, written)
    tested = {entry.summary.run: entry.tests for entry in entries if entry.tests is not None}
    _remove(connection, TESTS, tested)
    put(connection, TESTS, [test.to_row() for tests in tested.values() for test in tests])
    forget_summaries(connection, sorted(experiments | before.experiments))
    _prune(connection, before)


def remove(connection: Connection, runs: Sequence[str]) -> None:
    """Take runs and all that is theirs alone out of the index."""
    before = _shared(connection, runs)
    _remove(connection, RUNS, runs)
    forget_summaries(connection, sorted(before.experiments))
    _prune(connection, before)


def refresh_labels(connection: Connection, run: str, folder: Path) -> bool:
    """Make the index agree with the labels in a run folder; says whether it knows the run."""
    # Read inside the transaction: who comes last has read all that was written before.
    found = labels.read(folder)
    changed = connection.execute(update(RUNS).where(RUNS.c.run == run).values(note=found.note))
    if changed.rowcount:
        _write_tags(connection, {run: found})
    return bool(changed.rowcount)


def forget_summaries(connection: Connection, experiments: Sequence[str]) -> None:
    """Drop what is written down of how the success ratios of experiments are spread."""
    for experiment in experiments:
        connection.execute(delete(SUCCESSES).where(SUCCESSES.c.experiment == experiment))


def current_labels(summary: RunSummary) -> Labels:
    """As the folder has them now; where it is gone, as the summary does."""
    folder = Path(summary.folder)
    return labels.read(folder) if folder.is_dir() else Labels(summary.tags, summary.note)


def _write_tags(connection: Connection, written: Mapping[str, Labels]) -> None:
    _remove(connection, TAGS, written)
    put(connection, TAGS, [{"run": run, "tag": tag} for run, found in written.items() for tag in found.tags])


def _remove(connection: Connection, table: Table, runs: Iterable[str]) -> None:
    for portion in chunks(list(runs)):
        connection.execute(delete(table).where(table.c.run.in_(portion)))


def _add_specs(connection: Connection, specs: Mapping[str, Mapping[str, Any]]) -> None:
    new = _missing(connection, SPECS.c.digest, specs)
    put(connection, SPECS, [{"digest": name, "spec": specs[name]} for name in new])
    put(connection, PARAMETERS, [row for name in new for row in parameter_rows(specs[name], name)])


def _add_software(connection: Connection, software: Mapping[str, Mapping[str, str]]) -> None:
    rows = [
        {"software": name, "package": package, "version": version}
        for name in _missing(connection, VERSIONS.c.software, software)
        for package, version in software[name].items()
    ]
    put(connection, VERSIONS, rows)


def _missing(connection: Connection, column: Any, names: Collection[str]) -> list[str]:
    there: set[str] = set()
    for portion in chunks(sorted(names)):
        there.update(connection.scalars(select(column).where(column.in_(portion)).distinct()))
    return sorted(set(names) - there)


def _shared(connection: Connection, runs: Sequence[str]) -> _Shared:
    rows: list[Any] = []
    for portion in chunks(runs):
        query = select(RUNS.c.experiment, RUNS.c.spec, RUNS.c.software).where(RUNS.c.run.in_(portion))
        rows += connection.execute(query).all()
    return _Shared(
        frozenset(row.experiment for row in rows),
        frozenset(row.spec for row in rows),
        frozenset(row.software for row in rows if row.software is not None),
    )


def _prune(connection: Connection, before: _Shared) -> None:
    """Remove what no run refers to any more."""
    places: tuple[tuple[Any, Any, frozenset[str]], ...] = (
        (EXPERIMENTS.c.hash, RUNS.c.experiment, before.experiments),
        (SPECS.c.digest, RUNS.c.spec, before.specs),
        (VERSIONS.c.software, RUNS.c.software, before.software),
    )
    for column, reference, names in places:
        for portion in chunks(sorted(names)):
            used = select(reference).where(reference == column).exists()
            connection.execute(delete(column.table).where(column.in_(portion), ~used))
