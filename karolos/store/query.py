"""Finds the run that a selector means, own or shipped. Also `karolos.runs`: recorded runs as rows and data frames."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import sqlalchemy

from ..errors import NoSuchRunError, UsageError, closest
from ..records import RunFolder
from ..records.run_records import RunRecord, RunSummary, flatten
from ..records.shipped import FOLDER, SHIPPED, shipped_names
from ..records.sweep_records import BEST, best_name, read_sweep, sweep_folder
from .folders import open_index
from .store import Store
from .tables import RUNS, SUMMARY_FIELDS, means

SHORTEST_HASH = 6
"""Smallest number of digits that can be the beginning of a hash."""
_LISTED = 5
_LAST = re.compile(r"@last(?:-(\d{1,9}))?")
_HASH = re.compile(rf"[0-9a-f]{{{SHORTEST_HASH},}}")


class Records(tuple[RunSummary, ...]):
    """The found runs, newest first: a tuple of RunSummary, with tidy rows."""

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
    """The recorded runs, the newest first, as `karolos runs list` lists them; those of sweeps only with `trials`.

    `where` is a filter as of that command, e.g. "task=reach and agent.learning_rate<1e-2". `database` is a URL, by
    default that of the index in the folder `runs`.

    Raises UsageError if the filter cannot be read or the folder is missing, StoreError if the database cannot be read.
    """
    with index(runs, database) as store:
        if store is None:
            return Records(())
        return Records(store.records(store.runs(where=where, limit=limit, trials=None if trials else False)))


@contextmanager
def index(runs: str | Path, database: str | None) -> Iterator[Store | None]:
    """The index of `open_index`, closed at the end. A Python warning names each ignored file."""
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

    Raises UsageError if no run has a column.
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
    """The one run that a selector means: a path, what `find` takes, or the name of a shipped run.

    An own run comes before a shipped run of the same name, except with `shipped:NAME`. Errors name `runs` if there is
    no index. Raises UsageError if it means no run or several, RunError if the folder is damaged.
    """
    if is_run_folder(selector):
        return RunFolder.open(selector).summary()
    if found := shipped_run(selector, store):
        return found.summary()
    try:
        return find(existing(store, selector, runs), selector)
    except NoSuchRunError as error:
        shipped, own = shipped_names(), experiment_names(store) if store else []
        asked = selector.startswith(SHIPPED)
        like = closest(selector.removeprefix(SHIPPED), shipped if asked else [*own, *shipped])
        if like not in shipped or (like in own and not asked):
            hint = f"{error.hint}; {len(shipped)} policies ship, e.g. panda_pick"
            raise NoSuchRunError(error.what, hint=hint) from error
        name = f"{SHIPPED}{like}" if like in own else like
        hint = f"did you mean {name!r}, a shipped policy? `karolos runs list` shows your runs"
        raise NoSuchRunError(error.what, hint=hint) from error


def find_folder(selector: str, store: Store | None, runs: str | Path) -> RunFolder:
    """The folder of the run that `find_meant` finds. Also raises RunError if the folder is missing."""
    return RunFolder.open(find_meant(selector, store, runs).folder)


def existing(store: Store | None, selector: str, runs: str | Path) -> Store:
    """The index. Raises NoSuchRunError if there is none because there are no runs."""
    if store is None:
        what = f"{selector!r} means no run: there are no runs in {runs} yet"
        raise NoSuchRunError(what, hint="`karolos run SPEC` makes one")
    return store


def shipped_run(selector: str, store: Store | None) -> RunFolder | None:
    """The shipped run of this name, unless own runs have it, too; with the prefix `shipped:` always."""
    name = selector.removeprefix(SHIPPED)
    if name not in shipped_names() or (name == selector and store and store.runs(name=name, limit=1)):
        return None
    return RunFolder.open(FOLDER / name)


def select(store: Store, selector: str, *, or_trial: bool = False) -> tuple[RunSummary, ...]:
    """The runs that a selector means, the newest first. The first rule that finds runs counts:

    1. @last, the newest run; @last-2, the second before it
    2. a run's id, or the path of its folder
    3. the name of an experiment: all its runs
    4. the beginning of an experiment's hash (6 digits or more): all its runs
    5. the beginning of a run's id

    A spec file means all runs of its experiment. With `or_trial`, the name of a sweep's best spec that no run has means
    the trial that the final phase chose.

    Raises NoSuchRunError if it means no run, or a run folder that the index does not have; RunError if that is damaged;
    UsageError if it is the beginning of several ids or hashes.
    """
    last = _LAST.fullmatch(selector)
    if last:
        back = int(last[1] or 0)
        newest = store.runs(limit=back + 1)
        if not newest:
            raise UsageError("there are no runs yet", hint="`karolos run SPEC` makes one")
        if len(newest) <= back:
            raise NoSuchRunError(f"{selector!r} means no run", hint=f"there are {len(newest)}, from @last on")
        return newest[-1:]
    if is_spec(selector):
        from ..specification import load_spec  # noqa: PLC0415  (yaml)

        found = store.runs(experiment=load_spec(Path(selector), ()).hash())
        if not found:
            raise UsageError(f"there are no runs of {selector}", hint=f"`karolos run {selector}` makes them")
        return found
    identity = Path(selector).name
    if is_run_folder(selector) or os.path.dirname(selector):
        if found := _at(store, Path(selector)):
            return found
    elif identity:
        named = store.runs(ids=[identity]) or store.runs(name=selector)
        if found := named or _of_best(store, selector, or_trial):
            return found
        if _HASH.fullmatch(selector) and (found := store.runs(experiment=selector)):
            experiments = sorted({run.experiment for run in found})
            if len(experiments) > 1:
                shown = ", ".join(experiment[:12] for experiment in experiments[:_LISTED])
                raise UsageError(f"{selector!r} begins several experiments", hint=f"add digits: {shown}")
            return found
        if found := store.runs(prefix=identity, limit=_LISTED + 1):
            return (only(selector, found),)
    like = closest(identity, ["@last", *experiment_names(store)])
    hint = "`karolos runs list` shows them; @last is the newest"
    raise NoSuchRunError(f"{selector!r} means no run", hint=f"did you mean {like!r}? {hint}" if like else hint)


def experiment_names(store: Store) -> list[str]:
    """The names of the runs' experiments, each once."""
    return [row.name for row in store.fetch(sqlalchemy.select(RUNS.c.name).distinct())]


def _of_best(store: Store, selector: str, or_trial: bool) -> tuple[RunSummary, ...]:
    """The runs of the trial that a sweep chose, by its best spec's name; none for other names.

    Raises as `select`.
    """
    name = selector.removesuffix(best_name(""))
    trials = store.runs(prefix=f"{name}-t", trials=True) if name != selector else ()
    folder = next((folder for folder in map(sweep_folder, trials) if folder and folder.name == name), None)
    if folder is None:
        return ()
    sweep, _ = read_sweep(folder)
    if or_trial and sweep.final and sweep.best and (found := store.runs(name=sweep.best.name)):
        return found
    spec = os.path.join(sweep.folder, BEST)
    if os.path.isfile(spec):
        raise NoSuchRunError(f"{selector!r} means no run", hint=f"`karolos run {spec}` makes them")
    return ()


def _at(store: Store, path: Path) -> tuple[RunSummary, ...]:
    """The run that the index has at a path; none if there is no run folder. Raises as `select`."""
    there = is_run_folder(path)
    identity = RunFolder.open(path).id if there else path.name
    place = os.path.realpath(path)
    found = tuple(run for run in store.runs(ids=[identity]) if os.path.realpath(run.folder) == place)
    if there and not found:
        hint = "name its runs folder with --runs; `karolos db reindex` enters its runs"
        raise NoSuchRunError(f"the run folder {path} is not in the index", hint=hint)
    return found


def is_run_folder(selector: str | Path) -> bool:
    """Whether a selector is the path of a run folder."""
    return os.path.isfile(Path(selector) / "run.json")  # Path.is_file raises for a name that is too long


def is_spec(selector: str) -> bool:
    """Whether a selector is a spec file, or karolos:NAME."""
    return selector.startswith("karolos:") or (selector.endswith((".yaml", ".yml")) and os.path.isfile(selector))


def find(store: Store, selector: str) -> RunSummary:
    """The one run of the index that a selector means. Raises as `select`, and UsageError if it means several."""
    return only(selector, select(store, selector))


def only(selector: str, found: Sequence[RunSummary]) -> RunSummary:
    """The one found run. Raises UsageError if there are several."""
    if len(found) == 1:
        return found[0]
    listed = ", ".join(run.run for run in found[:_LISTED]) + (" ..." if len(found) > _LISTED else "")
    raise UsageError(f"{selector!r} means several runs", hint=f"one of {listed}; or @last")
