"""`karolos runs tag` and `note`: what a person writes on runs, while they run or later."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import UsageError

from ..common import Database, Json, Runs, rows
from ..selection import MANY_HELP, select_runs


def tag(
    run: Annotated[str, typer.Argument(metavar="RUN", help=MANY_HELP, show_default=False)],
    tags: Annotated[list[str], typer.Argument(metavar="TAG...", help="Words of your own.", show_default=False)],
    remove: Annotated[bool, typer.Option("--remove", help="Take the tags away.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Give a run tags, or all runs of an experiment. `karolos runs list 'tags=good'` finds them."""
    from karolos.records import labels

    change = labels.remove_tags if remove else labels.add_tags
    _relabel(run, lambda folder: change(folder, tags), runs, database, json=json)


def note(
    run: Annotated[str, typer.Argument(metavar="RUN", help=MANY_HELP, show_default=False)],
    text: Annotated[str | None, typer.Argument(metavar="[TEXT]", help="Replaces the note.", show_default=False)] = None,
    remove: Annotated[bool, typer.Option("--remove", help="Remove the note.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Write a note on a run, or on all runs of an experiment, in place of the one before."""
    from karolos.records import labels

    if (text is None) != remove or text == "":
        raise UsageError("a note needs a text", hint="karolos runs note RUN TEXT, or --remove and no text")
    _relabel(run, lambda folder: labels.set_note(folder, text or ""), runs, database, json=json)


def _relabel(selector: str, change: Callable[[Path], None], runs: Path, database: str | None, *, json: bool) -> None:
    """Write into the folders, which are the truth, and let the index read them again."""
    from karolos.records import RunFolder

    store, found = select_runs([selector], None, runs, database)
    with store:
        folders = [RunFolder.open(run.folder) for run in found]
        for folder in folders:
            change(folder.path)
            store.refresh_labels(folder)
        if json:
            rows([folder.summary().row() for folder in folders], json=True)
            return
    print(f"{len(folders)} run{'s' if len(folders) > 1 else ''} changed", file=sys.stderr)
