"""The run that somebody means, of a run of one's own or of one that ships."""

from __future__ import annotations

import os
from pathlib import Path

from ..errors import NoSuchRunError
from ..records import RunFolder
from ..records.run_records import RunSummary
from ..records.shipped import FOLDER, shipped_names
from ..registry import alternatives
from .store import Store


def find_meant(selector: str, store: Store | None, runs: str | Path) -> RunSummary:
    """The one run that a selector means: a path, what `Store.find` takes, or the name of a shipped run.

    A run of one's own with the name of a run that ships comes first. `runs` is named where there is no index.

    Raises:
        UsageError: it means no run, or several.
        RunError: the folder is damaged.
    """
    if os.path.isfile(Path(selector) / "run.json"):  # Path.is_file raises for a name that is too long
        return RunFolder.open(selector).summary()
    if shipped := shipped_run(selector, store):
        return shipped.summary()
    try:
        return existing(store, selector, runs).find(selector)
    except NoSuchRunError as error:
        ships = alternatives(selector, shipped_names(), what="policies that ship")
        raise NoSuchRunError(error.what, hint=f"{error.hint}; {ships}") from error


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
    """The run that ships of this name, unless there are runs of one's own with it."""
    if selector not in shipped_names() or (store and store.runs(name=selector, limit=1)):
        return None
    return RunFolder.open(FOLDER / selector)
