"""`karolos runs tag` and `note`: what a person writes on runs, at any time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import UsageError

from ..arguments import MANY_HELP, Database, Json, Runs, select_runs
from ..output import print_rows, say

_Run = Annotated[str, typer.Argument(metavar="RUN", help=MANY_HELP, show_default=False)]


def tag(
    run: _Run,
    tags: Annotated[list[str], typer.Argument(metavar="TAG...", help="Words of your own.", show_default=False)],
    remove: Annotated[bool, typer.Option("--remove", help="Remove these tags instead.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Add tags to a run, or to all runs of an experiment. `karolos runs list 'tags=good'` finds them."""
    from karolos.records import labels

    change = labels.remove_tags if remove else labels.add_tags
    _relabel(run, lambda folder: change(folder, tags), runs, database, json=json)


def note(
    run: _Run,
    text: Annotated[str | None, typer.Argument(metavar="[TEXT]", help="The new note.", show_default=False)] = None,
    remove: Annotated[bool, typer.Option("--remove", help="Remove the note.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Set the note of a run, or of all runs of an experiment. It replaces the note before."""
    from karolos.records import labels

    if (text is None) != remove or text == "":
        raise UsageError("a note needs a text", hint="karolos runs note RUN TEXT, or --remove and no text")
    _relabel(run, lambda folder: labels.set_note(folder, text or ""), runs, database, json=json)


def _relabel(selector: str, change: Callable[[Path], None], runs: Path, database: str | None, *, json: bool) -> None:
    """Write into the run folders, and let the index read them again."""
    from karolos.records import RunFolder

    store, found = select_runs([selector], None, runs, database)
    with store:
        folders = [RunFolder.open(run.folder) for run in found]
        for folder in folders:
            change(folder.path)
            store.refresh_labels(folder)
        if json:
            print_rows([folder.summary().row() for folder in folders], json=True)
            return
    say(f"{len(folders)} run{'s' if len(folders) > 1 else ''} changed")
