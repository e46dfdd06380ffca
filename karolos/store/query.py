"""The run that somebody means, own or shipped; and `karolos.runs`: recorded runs as rows and data frames."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from ..errors import NoSuchRunError, UsageError
from ..records import RunFolder
from ..records.run_records import RunRecord, RunSummary, flatten
from ..records.shipped import FOLDER, SHIPPED, shipped_names
from ..registry import closest
from .folders import open_index
from .rows import SUMMARY_FIELDS, means
from .selectors import experiment_names, is_run_folder
from .store import Store


class Records(tuple[RunSummary, ...]):
    """The runs that were found, the newest first: a tuple of RunSummary, and tidy rows."""

    records: tuple[RunRecord, ...]
    """Each run with its spec and its tests."""

    def __new__(cls, records: tuple[RunRecord, ...]) -> Records:
        found = super().__new__(cls, (record.summary for record in records))
        found.records = records
        return found

    def rows(self) -> Any:
        """One row per run: the fields of RunSummary and the settings. A pandas.DataFrame if pandas is installed."""
        return _table([_row(record) for record in self.records])

    def tests(self) -> Any:
        """One row per test of each run: run, seed, steps, seconds, success, return, measures; else as `rows`."""
        return _table(
            [
                {
                    **{name: getattr(record.summary, name) for name in ("run", "name", "experiment", "seed")},
                    **{name: getattr(test, name) for name in ("steps", "seconds", "episodes")},
                    **{name: getattr(test, name) for name in ("success_any", "success_end", "mean_return")},
                    **means(test.measures),
                }
                for record in self.records
                for test in record.tests
            ]
        )


def runs(
    where: str | None = None,
    *,
    runs: str | Path = "runs",
    database: str | None = None,
    limit: int | None = None,
    trials: bool = False,
) -> Records:
    """The recorded runs, the newest first, as `karolos runs list` lists them.

    Args:
        where: a filter as of `karolos runs list`, e.g. "task=reach and agent.learning_rate<1e-2"; all runs by default.
        runs: the runs folder.
        database: URL of the database; by default the one in the runs folder.
        limit: at most this many runs.
        trials: also the runs of sweeps' trials.

    Raises:
        UsageError: the filter cannot be read, or there is no such folder.
        StoreError: the database cannot be read.
    """
    with index(runs, database) as store:
        if store is None:
            return Records(())
        return Records(store.records(store.runs(where=where, limit=limit, trials=None if trials else False)))


@contextmanager
def index(runs: str | Path, database: str | None) -> Iterator[Store | None]:
    """The index that `open_index` opens, closed at the end. A Python warning names each file that it leaves out."""
    store, rebuilt = open_index(runs, database)
    with store or nullcontext():
        for problem in rebuilt.problems if rebuilt else ():
            warnings.warn(problem, stacklevel=4)
        yield store


def prepare_index(runs: Path, url: str) -> None:
    """Rebuild or create the index of a runs folder if it is missing. Raises StoreError if it cannot be used."""
    with index(runs, url) as store:
        if store is None:
            Store(url).close()


def column_values(store: Store, found: Sequence[RunSummary], columns: Sequence[str]) -> list[dict[str, Any]]:
    """One row per run with these columns: fields of RunSummary, settings by their key paths, means of measures.

    Raises:
        UsageError: no run has a column.
    """
    columns = [column.strip() for column in columns]
    rows = [_row(record) for record in store.records(found)]
    known = set(SUMMARY_FIELDS).union(*rows)
    for column in columns:
        if found and column not in known:
            like = closest(column, sorted(known))
            hint = f"did you mean {like!r}?" if like else "a field of `runs list --json`, or a setting as agent.hidden"
            raise UsageError(f"no run has a column {column!r}", hint=hint)
    return [{name: row.get(name) for name in columns} for row in rows]


def _row(record: RunRecord) -> dict[str, Any]:
    """The fields of the summary, then the settings; a field comes before a setting of the same name."""
    row = record.summary.row()
    row |= means(row.pop("measures"))
    return row | {key: value for key, value in flatten(record.spec) if key not in row}


def _table(rows: list[dict[str, Any]]) -> Any:
    try:
        import pandas  # noqa: PLC0415  (optional)
    except ImportError:
        return rows
    return pandas.DataFrame(rows)


def find_meant(selector: str, store: Store | None, runs: str | Path) -> RunSummary:
    """The one run that a selector means: a path, what `Store.find` takes, or the name of a shipped run.

    A run of one's own with the name of a run that ships comes first, except with `shipped:NAME`. `runs` is named where
    there is no index.

    Raises:
        UsageError: it means no run, or several.
        RunError: the folder is damaged.
    """
    if is_run_folder(selector):
        return RunFolder.open(selector).summary()
    if found := shipped_run(selector, store):
        return found.summary()
    try:
        return existing(store, selector, runs).find(selector)
    except NoSuchRunError as error:
        shipped, own = shipped_names(), experiment_names(store.database) if store else []
        asked = selector.startswith(SHIPPED)
        like = closest(selector.removeprefix(SHIPPED), shipped if asked else [*own, *shipped])
        if like not in shipped or (like in own and not asked):
            hint = f"{error.hint}; {len(shipped)} policies ship, e.g. panda_pick"
            raise NoSuchRunError(error.what, hint=hint) from error
        name = f"{SHIPPED}{like}" if like in own else like
        hint = f"did you mean {name!r}, a policy that ships? `karolos runs list` shows yours"
        raise NoSuchRunError(error.what, hint=hint) from error


def find_folder(selector: str, store: Store | None, runs: str | Path) -> RunFolder:
    """The folder of the run that `find_meant` finds. Raises RunError as well if the folder is missing."""
    return RunFolder.open(find_meant(selector, store, runs).folder)


def existing(store: Store | None, selector: str, runs: str | Path) -> Store:
    """The index. Raises NoSuchRunError if there is none because there are no runs."""
    if store is None:
        what = f"{selector!r} means no run: there are no runs in {runs} yet"
        raise NoSuchRunError(what, hint="`karolos run SPEC` makes one")
    return store


def shipped_run(selector: str, store: Store | None) -> RunFolder | None:
    """The run that ships of this name, unless there are runs of one's own with it; always with `shipped:` before it."""
    name = selector.removeprefix(SHIPPED)
    if name not in shipped_names() or (name == selector and store and store.runs(name=name, limit=1)):
        return None
    return RunFolder.open(FOLDER / name)
