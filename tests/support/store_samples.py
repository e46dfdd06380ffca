"""Summaries and tests of runs for the store."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from karolos.records import RunFolder
from karolos.records.results import TestResult
from karolos.records.run_records import RunRecord, RunSummary
from karolos.store import Store

SPEC = {"name": "reach", "environment": {"name": "toy"}, "robot": None, "agent": {"name": "sac"}, "seeds": [3]}


def result(steps: int, successes: int) -> TestResult:
    flags = tuple(index < successes for index in range(20))
    return TestResult(steps, steps / 100, flags, (True,) * 20, (False,) * 20, (-1.5,) * 20, (9,) * 20)


def new_run(store: Store, runs: Path, name: str = "reach", seed: int = 3) -> RunFolder:
    run = RunFolder.create(runs, name, seed)
    run.describe(SPEC, experiment="abc")
    store.add_records([run.record()])
    return run


def stored(store: Store, run: str) -> RunRecord:
    """What the index has of a run."""
    (record,) = store.records([store.find(run)])
    return record


def bare(store: Store, run: str, **values: Any) -> RunSummary:
    """A run that has no folder any more."""
    summary = RunSummary(
        **dict.fromkeys(("success_any", "success_end", "steps_to_95", "seconds_to_95"), None),
        **dict.fromkeys(("episodes", "environment", "robot", "task", "agent", "error"), None),
        run=run,
        experiment="abc",
        seed=0,
        state="finished",
        steps=0,
        seconds=0.0,
        name="x",
        attempt=1,
        created="2026-01-01T00:00:00.000000Z",
        updated="2026-01-01T00:00:00.000000Z",
        folder="/nowhere/x",
    )
    summary = replace(summary, **values)
    store.add_records([RunRecord(summary, SPEC, (), {})])
    return summary
