"""From what a person types to the run that is meant."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from karolos.errors import UsageError

if TYPE_CHECKING:
    from karolos.run_folder import RunFolder
    from karolos.store import Store


def open_store(runs: Path, database: str | None) -> Store | None:
    """The index; one that is missing is rebuilt from the run folders. None where there is neither."""
    from karolos.store import Store, reindex

    if not os.path.isdir(runs) and database is None and runs != Path("runs"):
        raise UsageError(f"there is no folder {runs}", hint="name the runs folder with --runs")
    url = database or Store.default_url(runs)
    if Store.exists(url):
        return Store(url)
    if not any(runs.glob("*/run.json")):
        return None
    store = Store(url)
    done = reindex(store, runs)
    print(f"the index was missing and is rebuilt from {done.runs} run folders", file=sys.stderr)
    for problem in done.problems:
        print(f"warning: {problem}", file=sys.stderr)
    return store


def open_run(selector: str, runs: Path, database: str | None) -> RunFolder:
    """The folder of the one run that a selector means: an id, the beginning of one, @last, or a run folder's path.

    Raises:
        UsageError: it means no run or several.
        RunError: its folder is gone or damaged.
    """
    from karolos.run_folder import RunFolder

    if (Path(selector) / "run.json").is_file():
        return RunFolder.open(selector)
    store = open_store(runs, database)
    if store is None:
        raise UsageError(
            f"{selector!r} means no run: there are none in {runs} yet", hint="`karolos run SPEC` makes one"
        )
    with store:
        return RunFolder.open(store.find(selector).folder)
