"""Entering runs into the index and removing them. Every function works inside a transaction that writes."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Table, delete, select, update

from ..records import labels
from ..records.labels import Labels
from ..records.results import TestCounts
from ..records.run_records import RunRecord, RunSummary
from .rows import chunks, digest, parameter_rows, put, run_row, test_row, upsert, without_seeds
from .tables import EXPERIMENTS, PARAMETERS, RUNS, SPECS, SUCCESSES, TAGS, TESTS, VERSIONS


@dataclass(frozen=True)
class RunEntry:
    """What the index stores of a run."""

    summary: RunSummary
    spec: Mapping[str, Any]
    """Resolved, without seeds."""
    spec_digest: str
    versions: Mapping[str, str] | None
    software: str | None
    """Digest of the versions."""
    tests: Sequence[TestCounts] | None
    """None keeps the tests that are stored."""

    @classmethod
    def make(
        cls,
        summary: RunSummary,
        spec: Mapping[str, Any],
        versions: Mapping[str, str] | None,
        tests: Sequence[TestCounts] | None = None,
    ) -> RunEntry:
        shared = without_seeds(spec)
        return cls(summary, shared, digest(shared), versions, digest(versions) if versions else None, tests)

    @classmethod
    def of(cls, record: RunRecord) -> RunEntry:
        """The entry of a run folder."""
        return cls.make(record.summary, record.spec, record.versions, record.tests)


@dataclass(frozen=True)
class _Shared:
    """Rows that several runs refer to. They are deleted with the last of these runs."""

    experiments: frozenset[str]
    specs: frozenset[str]
    software: frozenset[str]


def enter(connection: Connection, entries: Sequence[RunEntry], home: Path | None) -> None:
    """Enter runs; replace those that are stored under the same ids."""
    before = _shared(connection, [entry.summary.run for entry in entries])
    _add_specs(connection, {entry.spec_digest: entry.spec for entry in entries})
    _add_software(
        connection, {entry.software: entry.versions for entry in entries if entry.software and entry.versions}
    )
    experiments = sorted({entry.summary.experiment for entry in entries})
    upsert(connection, EXPERIMENTS, [{"hash": name} for name in experiments], keys=("hash",), replace_old=False)
    current = {entry.summary.run: _current_labels(entry.summary) for entry in entries}
    rows = [
        {
            **run_row(entry.summary, home),
            "note": current[entry.summary.run].note,
            "spec": entry.spec_digest,
            "software": entry.software,
        }
        for entry in entries
    ]
    upsert(connection, RUNS, rows, keys=("run",))
    _write_tags(connection, current)
    tests = {entry.summary.run: entry.tests for entry in entries if entry.tests is not None}
    _delete(connection, TESTS, tests)
    put(connection, TESTS, [test_row(run, test) for run, found in tests.items() for test in found])
    forget_summaries(connection, sorted({*experiments, *before.experiments}))
    _prune(connection, before)


def remove(connection: Connection, runs: Sequence[str]) -> None:
    """Remove runs and everything that only they refer to."""
    before = _shared(connection, runs)
    _delete(connection, RUNS, runs)
    forget_summaries(connection, sorted(before.experiments))
    _prune(connection, before)


def refresh_labels(connection: Connection, run: str, folder: Path) -> bool:
    """Copy the labels from a run folder into the index; returns whether the index has the run."""
    # Read inside the transaction: the last writer has read everything that was written before.
    current = labels.read(folder)
    changed = connection.execute(update(RUNS).where(RUNS.c.run == run).values(note=current.note))
    if changed.rowcount:
        _write_tags(connection, {run: current})
    return bool(changed.rowcount)


def forget_summaries(connection: Connection, experiments: Sequence[str]) -> None:
    """Delete the stored success summaries of experiments."""
    for experiment in experiments:
        connection.execute(delete(SUCCESSES).where(SUCCESSES.c.experiment == experiment))


def _current_labels(summary: RunSummary) -> Labels:
    """The labels in the run folder now; those of the summary if the folder is gone."""
    folder = Path(summary.folder)
    return labels.read(folder) if folder.is_dir() else Labels(summary.tags, summary.note)


def _write_tags(connection: Connection, current: Mapping[str, Labels]) -> None:
    _delete(connection, TAGS, current)
    put(connection, TAGS, [{"run": run, "tag": tag} for run, found in current.items() for tag in found.tags])


def _delete(connection: Connection, table: Table, runs: Iterable[str]) -> None:
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
    stored: set[str] = set()
    for portion in chunks(sorted(names)):
        stored.update(connection.scalars(select(column).where(column.in_(portion)).distinct()))
    return sorted(set(names) - stored)


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
    """Delete rows that no run refers to any more."""
    references: tuple[tuple[Any, Any, frozenset[str]], ...] = (
        (EXPERIMENTS.c.hash, RUNS.c.experiment, before.experiments),
        (SPECS.c.digest, RUNS.c.spec, before.specs),
        (VERSIONS.c.software, RUNS.c.software, before.software),
    )
    for column, reference, names in references:
        for portion in chunks(sorted(names)):
            used = select(reference).where(reference == column).exists()
            connection.execute(delete(column.table).where(column.in_(portion), ~used))
