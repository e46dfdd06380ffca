"""Entering runs into the index and removing them. Every function works inside a transaction that writes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, bindparam, delete, select, update

from ..records import labels
from ..records.labels import Labels
from ..records.run_records import RunRecord, RunSummary
from .rows import digest, put, run_row, without_seeds
from .tables import RUNS, SOFTWARE, SPECS, SUCCESSES, TESTS


def enter(connection: Connection, records: Sequence[RunRecord], home: Path | None) -> None:
    """Enter runs with their tests; replace those that are stored under the same ids."""
    specs: dict[str, Mapping[str, Any]] = {}
    software: dict[str, Mapping[str, str]] = {}
    runs, tests = [], []
    for record in records:
        run, spec = record.summary.run, without_seeds(record.spec)
        shared = {"spec": digest(spec), "software": digest(record.versions)}
        specs[shared["spec"]], software[shared["software"]] = spec, record.versions
        # Read inside the transaction: the last writer has read everything that was written before.
        current = asdict(_current_labels(record.summary))
        runs.append(run_row(record.summary, home) | current | shared)
        tests += [{"run": run, **vars(test)} for test in record.tests]
    for table, contents in ((SPECS, specs), (SOFTWARE, software)):
        rows = [{"digest": name, "content": content} for name, content in contents.items()]
        put(connection, table, rows, replace_old=False)
    put(connection, RUNS, runs, replace_old=True)
    _for_each_run(connection, delete(TESTS).where(TESTS.c.run == bindparam("one")), [row["run"] for row in runs])
    put(connection, TESTS, tests)
    forget_summaries(connection, {record.summary.experiment for record in records})


def remove(connection: Connection, runs: Sequence[str]) -> None:
    """Remove runs and everything that only they refer to."""
    experiment = select(RUNS.c.experiment).where(RUNS.c.run == bindparam("one")).scalar_subquery()
    _for_each_run(connection, delete(SUCCESSES).where(SUCCESSES.c.experiment == experiment), runs)
    _for_each_run(connection, delete(RUNS).where(RUNS.c.run == bindparam("one")), runs)
    for digests, references in ((SPECS.c.digest, RUNS.c.spec), (SOFTWARE.c.digest, RUNS.c.software)):
        used = select(references).where(references == digests).exists()
        connection.execute(delete(digests.table).where(~used))


def refresh_labels(connection: Connection, run: str, folder: Path) -> bool:
    """Copy the labels from a run folder into the index; returns whether the index has the run."""
    return bool(connection.execute(update(RUNS).where(RUNS.c.run == run).values(asdict(labels.read(folder)))).rowcount)


def forget_summaries(connection: Connection, experiments: Collection[str]) -> None:
    """Delete the stored success summaries of experiments."""
    for experiment in experiments:
        connection.execute(delete(SUCCESSES).where(SUCCESSES.c.experiment == experiment))


def _for_each_run(connection: Connection, statement: Any, runs: Sequence[str]) -> None:
    """Execute a statement with each of some runs as its parameter `one`."""
    if runs:
        connection.execute(statement, [{"one": run} for run in runs])


def _current_labels(summary: RunSummary) -> Labels:
    """The labels in the run folder now; those of the summary if the folder is gone."""
    folder = Path(summary.folder)
    return labels.read(folder) if folder.is_dir() else Labels(summary.tags, summary.note)
