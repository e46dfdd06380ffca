"""From what a person types to the runs that are meant."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from karolos.errors import UsageError
from karolos.report.terminal import clean

if TYPE_CHECKING:
    from karolos.records import RunFolder
    from karolos.records.run_records import RunSummary
    from karolos.store import Store

FILTER_HELP = (
    "Runs that fit, e.g. 'task=reach and agent.learning_rate<1e-3 and not state in (failed, lost)'; "
    "= != < <= > >= ~ (contains) in; names of columns, settings of the spec, tags, note, versions.PACKAGE."
)
MANY_HELP = (
    "A run's id or how it begins, @last, @last-2, a run folder; or an experiment's name, the beginning of its hash "
    "or a SPEC.yaml, which mean all its runs."
)
_SPECS = (".yaml", ".yml")


def open_store(runs: Path, database: str | None) -> Store | None:
    """The index; one that is missing is rebuilt from the run folders. None where there is neither."""
    from karolos.store import Store, reindex

    if not os.path.isdir(runs) and database is None and runs != Path("runs"):
        raise UsageError(f"there is no folder {runs}", hint="name the runs folder with --runs")
    url = database or Store.default_url(runs)
    if Store.exists(url):
        return Store(url)
    if not any(runs.glob("*/run.json")) and not any(runs.glob("sweeps/*/sweep.json")):
        return None
    store = Store(url)
    done = reindex(store, runs)
    print(f"the index was missing and is rebuilt from {done.runs} run folders", file=sys.stderr)
    for problem in done.problems:
        print(f"warning: {clean(problem)}", file=sys.stderr)
    return store


def open_run(selector: str, runs: Path, database: str | None) -> RunFolder:
    """The folder of the one run that a selector means (MANY_HELP), or a run folder's path.

    Raises:
        UsageError: it means no run or several.
        RunError: its folder is gone or damaged.
    """
    from karolos.records import RunFolder

    if (Path(selector) / "run.json").is_file():
        return RunFolder.open(selector)
    store, summary = find_run(selector, runs, database)
    store.close()
    return RunFolder.open(summary.folder)


def check_checkpoint(name: str) -> None:
    """Refuse (UsageError) a checkpoint that no run keeps."""
    if name not in ("best", "last"):
        raise UsageError(f"there is no checkpoint {name!r}", hint="a run keeps best and last")


def find_run(selector: str, runs: Path, database: str | None) -> tuple[Store, RunSummary]:
    """The open index, and the one run in it that a selector means.

    Raises:
        UsageError: it means no run or several.
    """
    store = _needed(selector, runs, database)
    if is_spec(selector):
        from karolos.store.selectors import only

        return store, only(selector, _of_spec(store, selector))
    return store, store.find(selector)


def select_runs(
    selectors: Sequence[str], where: str | None, runs: Path, database: str | None
) -> tuple[Store, tuple[RunSummary, ...]]:
    """The open index, and the runs that any of the selectors means and that fit the filter, each once.

    Raises:
        UsageError: there is neither selector nor filter, a selector means no run, or no run fits.
    """
    if not selectors and where is None:
        raise UsageError("which runs?", hint="name RUN, or give --where FILTER")
    store = _needed(selectors[0] if selectors else str(where), runs, database)
    found = {run.run: run for selector in selectors for run in select(store, selector)}
    if where is not None:
        fitting = {run.run: run for run in store.runs(where=where)}
        found = {run: fitting[run] for run in found if run in fitting} if selectors else fitting
    if not found:
        raise UsageError("no runs fit the filter", hint="`karolos runs list FILTER` shows what fits")
    return store, tuple(found.values())


def select(store: Store, selector: str) -> tuple[RunSummary, ...]:
    """The runs that a selector means: as `Store.select`, or those of the experiment that a spec file describes."""
    return _of_spec(store, selector) if is_spec(selector) else store.select(selector)


def _of_spec(store: Store, path: str) -> tuple[RunSummary, ...]:
    from karolos.spec import load_spec

    digest = load_spec(Path(path), ()).hash()
    found = store.runs(experiment=digest)
    if not found:
        raise UsageError(f"there are no runs of {path}", hint=f"`karolos run {path}` makes them")
    return found


def is_spec(selector: str) -> bool:
    """Whether it is a spec file."""
    return selector.endswith(_SPECS) and os.path.isfile(selector)


def _needed(selector: str, runs: Path, database: str | None) -> Store:
    store = open_store(runs, database)
    if store is None:
        raise UsageError(
            f"{selector!r} means no run: there are none in {runs} yet", hint="`karolos run SPEC` makes one"
        )
    return store
