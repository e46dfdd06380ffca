"""From what a person types to the run that is meant."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from karolos.errors import UsageError

if TYPE_CHECKING:
    from karolos.run_folder import RunFolder


def open_run(selector: str, runs: Path, database: str | None) -> RunFolder:
    """The folder of the one run that a selector means: an id, the beginning of one, @last, or a run folder's path.

    Raises:
        UsageError: it means no run or several.
        RunError: its folder is gone or damaged.
    """
    from karolos.run_folder import RunFolder

    from .runs import _open_store

    if (Path(selector) / "run.json").is_file():
        return RunFolder.open(selector)
    store = _open_store(runs, database)
    if store is None:
        raise UsageError(f"{selector!r} means no run: there are none in {runs} yet", hint="`karolos run SPEC` makes one")
    with store:
        return RunFolder.open(store.find(selector).folder)
