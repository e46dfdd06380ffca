"""`karolos.runs`: the recorded runs from Python, and as rows for tables and data frames."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, overload

from sqlalchemy import select

from ..errors import UsageError
from ..records.results import TestCounts
from ..records.run_records import RunSummary
from ..registry import closest
from .database import Database
from .rows import SUMMARY_COLUMNS, chunks
from .store import Store
from .tables import PARAMETERS, RUNS


@dataclass(frozen=True)
class Records(Sequence[RunSummary]):
    """The runs that were found, the newest first: a sequence of RunSummary, and tidy rows."""

    summaries: tuple[RunSummary, ...]
    settings: tuple[dict[str, Any], ...]
    """Of each run: the spec's settings by their key paths, e.g. {"agent.learning_rate": 0.001}."""
    counts: tuple[tuple[TestCounts, ...], ...]
    """Of each run: its tests in the order of their steps."""

    @overload
    def __getitem__(self, index: int) -> RunSummary: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[RunSummary]: ...
    def __getitem__(self, index: int | slice) -> RunSummary | Sequence[RunSummary]:
        return self.summaries[index]

    def __len__(self) -> int:
        return len(self.summaries)

    def rows(self) -> Any:
        """One row per run: the fields of RunSummary and the settings. A pandas.DataFrame if pandas is installed."""
        pairs = zip(self.summaries, self.settings, strict=True)
        return _table([summary.row() | _new(settings, summary.row()) for summary, settings in pairs])

    def tests(self) -> Any:
        """One row per test of each run: run, seed, steps, seconds, success, return. A pandas.DataFrame as `rows`."""
        return _table(
            [
                {
                    **{name: getattr(summary, name) for name in ("run", "name", "experiment", "seed")},
                    **{name: getattr(test, name) for name in ("steps", "seconds", "episodes")},
                    "success_any": test.success_any,
                    "success_end": test.success_end,
                    "mean_return": test.mean_return,
                }
                for summary, tests in zip(self.summaries, self.counts, strict=True)
                for test in tests
            ]
        )


def runs(
    where: str | None = None, *, runs: str | Path = "runs", database: str | None = None, limit: int | None = None
) -> Records:
    """The recorded runs, the newest first.

    Args:
        where: a filter as of `karolos runs list`, e.g. "task=reach and agent.learning_rate<1e-2"; all runs by default.
        runs: the runs folder.
        database: URL of the database; by default the one in the runs folder.
        limit: at most this many runs.

    Raises:
        UsageError: the filter cannot be read.
        StoreError: the database cannot be read.
    """
    url = database or Store.default_url(runs)
    if not Store.exists(url):
        return Records((), (), ())
    with Store(url) as store:
        found = store.runs(where=where, limit=limit)
        names = [run.run for run in found]
        settings, tests = settings_of(store.database, names), store.tests_of(names)
    return Records(found, tuple(settings[name] for name in names), tuple(tests[name] for name in names))


def settings_of(database: Database, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """The settings of each of these runs by their key paths."""
    found: dict[str, dict[str, Any]] = {name: {} for name in names}
    query = select(RUNS.c.run, PARAMETERS.c.key, PARAMETERS.c.value).join(PARAMETERS, PARAMETERS.c.spec == RUNS.c.spec)
    for portion in chunks(names):
        for run, key, value in database.fetch(query.where(RUNS.c.run.in_(portion))):
            found[run][key] = json.loads(value)
    return found


def column_values(store: Store, found: Sequence[RunSummary], columns: Sequence[str]) -> list[dict[str, Any]]:
    """One row per run with these columns: fields of RunSummary, or settings by their key paths; None if it has none.

    Raises:
        UsageError: no run has a column.
    """
    settings = settings_of(store.database, [run.run for run in found])
    known = {*SUMMARY_COLUMNS, "tags"}.union(*settings.values())
    for column in columns:
        if found and column not in known:
            like = closest(column, sorted(known))
            hint = f"did you mean {like!r}?" if like else "a field of `runs list --json`, or a setting as agent.hidden"
            raise UsageError(f"no run has a column {column!r}", hint=hint)
    return [{name: (settings[run.run] | run.row()).get(name) for name in columns} for run in found]


def _new(settings: dict[str, Any], row: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in settings.items() if key not in row}


def _table(rows: list[dict[str, Any]]) -> Any:
    try:
        import pandas  # noqa: PLC0415  (optional)
    except ImportError:
        return rows
    return pandas.DataFrame(rows)
