"""`karolos runs show`: everything about one run."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..arguments import Database, Json, OneRun, Runs, find_run
from ..output import print_rows, print_table, warn

if TYPE_CHECKING:
    from karolos.records import RunFolder
    from karolos.records.results import TestCounts, TestResult
    from karolos.records.run_records import RunSummary
    from karolos.records.transfer_results import TransferResult
    from karolos.store import Store


def show(
    run: OneRun,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Show a run: state, tests with 95 % intervals, spec, checkpoints, versions, command and git commit."""
    store, summary = find_run(run, runs, database)
    with store:
        view = _from_folder(summary) if os.path.isdir(summary.folder) else _from_index(store, summary)
    if json:
        print_rows([view.row()], json=True)
    else:
        _print_view(view)


@dataclass(frozen=True)
class _View:
    """Everything known about one run."""

    summary: RunSummary
    tests: Sequence[TestCounts]
    spec: Mapping[str, Any]
    checkpoints: Sequence[Mapping[str, Any]] = ()
    problems: Sequence[str] = ()
    results: Sequence[TestResult] = ()
    """The tests episode by episode, as far as the folder has them."""
    transfers: Sequence[TransferResult] = ()
    """Tests under changed settings (`karolos test`)."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """Versions, machine, command and git commit."""

    def row(self) -> dict[str, Any]:
        from karolos.records.results import WITHIN

        known = [result for result in self.results if result.distances]
        near = {one.steps: {"within_m": {f"{far:g}": one.within(far) for far in WITHIN}} for one in known}
        return {
            **self.summary.row(),
            "tests": [_test_row(test) | near.get(test.steps, {}) for test in self.tests],
            "transfers": [transfer.row() for transfer in self.transfers],
            "checkpoints": list(self.checkpoints),
            "problems": list(self.problems),
            "spec": self.spec,
            **self.about,
        }


def _from_folder(summary: RunSummary) -> _View:
    from karolos.records import RunFolder
    from karolos.records import transfer_results as transfers

    folder = RunFolder.open(summary.folder)
    record = folder.record()
    checkpoints, damaged = _checkpoints(folder)
    description = folder.description()
    transferred, unreadable = transfers.read(folder)
    return _View(
        summary=record.summary,
        tests=record.tests,
        spec=record.spec,
        checkpoints=checkpoints,
        problems=(*record.problems, *damaged, *unreadable),
        results=folder.tests(),
        transfers=transferred,
        about={key: description.get(key) for key in ("versions", "machine", "command", "git")},
    )


def _from_index(store: Store, summary: RunSummary) -> _View:
    """What the index has of a run whose folder is missing."""
    return _View(
        summary=summary,
        tests=store.tests(summary.run),
        spec=store.spec(summary.experiment),
        problems=(f"the run folder is missing: {summary.folder}",),
    )


def _test_row(test: TestCounts) -> dict[str, Any]:
    from karolos.statistics.intervals import wilson

    return {
        "steps": test.steps,
        "seconds": test.seconds,
        "episodes": test.episodes,
        "success_any": test.any / test.episodes,
        "success_any_interval": wilson(test.any, test.episodes),
        "success_end": test.end / test.episodes,
        "success_end_interval": wilson(test.end, test.episodes),
        "solved_at_reset": test.reset,
    }


def _checkpoints(folder: RunFolder) -> tuple[list[dict[str, Any]], list[str]]:
    """The metadata of the checkpoints that can be read, and what is wrong with the others."""
    from karolos import checkpoint

    found, problems = [], []
    for name in checkpoint.names(folder.checkpoints):
        try:
            found.append({"name": name, **checkpoint.read_meta(folder.checkpoints, name)})
        except checkpoint.CheckpointError as error:
            problems.append(str(error))
    return found, problems


def _print_view(view: _View) -> None:
    from karolos.report.tables import duration, facts_table, flatten, table_of_tests, transfers_table

    run, about = view.summary, view.about
    git = about.get("git") or {}
    commit = f"{git.get('commit', '')[:12]}{' with changes (code.diff)' if git.get('dirty') else ''}" if git else None
    steps = f"{run.steps:,}, {duration(run.seconds)} of collecting and learning"
    solved = None if run.steps_to_95 is None else f"{run.steps_to_95:,} steps, {duration(run.seconds_to_95)}"
    facts = {
        "run": run.run,
        "state": run.state if run.error is None else f"{run.state}: {run.error}",
        "experiment": run.experiment,
        "steps": steps,
        "to .95": solved,
        "created": run.created,
        "updated": run.updated,
        "folder": run.folder,
        "tags": ", ".join(run.tags) or None,
        "note": run.note,
        "checkpoints": ", ".join(f"{point['name']} ({point.get('steps', 0):,} steps)" for point in view.checkpoints)
        or "none",
        "command": " ".join(about["command"]) if about.get("command") else None,
        "git commit": commit,
        "versions": ", ".join(f"{name} {version}" for name, version in (about.get("versions") or {}).items()) or None,
    }
    print_table(facts_table(facts))
    if view.tests:
        print_table(table_of_tests(view.tests, view.results, title="tests"))
    else:
        print("\nno tests yet")
    if view.transfers:
        print_table(transfers_table(view.transfers, title="tests under changed settings"))
    print_table(facts_table(dict(flatten(view.spec)), title="spec"))
    for problem in view.problems:
        warn(problem)
