"""`karolos runs rm` and `restore`: into the trash and out of it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import UsageError
from karolos.report.terminal import clean

from ..common import Database, Json, Runs, rows
from ..selection import FILTER_HELP, MANY_HELP, open_store, select_runs


def remove(
    run: Annotated[list[str] | None, typer.Argument(metavar="[RUN]...", help=MANY_HELP, show_default=False)] = None,
    where: Annotated[str | None, typer.Option(metavar="FILTER", help=FILTER_HELP, show_default=False)] = None,
    purge: Annotated[bool, typer.Option("--purge", help="Empty the trash for good; takes no RUN.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Throw runs away: into .trash in the runs folder, from where `karolos runs restore` brings them back."""
    from karolos.records import RunFolder, trash

    if purge:
        if run or where:
            raise UsageError("--purge empties the trash and takes no RUN", hint="first rm RUN, then rm --purge")
        gone = trash.thrown_away(runs)
        for path in gone:
            trash.purge(path)
        print(f"{len(gone)} runs removed for good", file=sys.stderr)
        return
    store, found = select_runs(run or (), where, runs, database)
    with store:
        moved = []
        for summary in found:
            path = trash.throw_away(RunFolder.open(summary.folder))
            store.remove_runs([summary.run])
            moved.append({"run": summary.run, "folder": str(path)})
    _tell(moved, json=json)
    print("`karolos runs restore RUN` brings them back, `karolos runs rm --purge` empties the trash", file=sys.stderr)


def restore(
    run: Annotated[list[str], typer.Argument(metavar="RUN...", help="How its id begins.", show_default=False)],
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Bring runs back out of the trash, with their tests, tags and note."""
    from karolos.records import trash
    from karolos.store import Store

    paths = list(dict.fromkeys(trash.find(runs, selector) for selector in run))
    back = []
    with open_store(runs, database) or Store(database or Store.default_url(runs)) as store:
        for path in paths:
            folder = trash.restore(path)
            record = folder.record()
            store.add_records([record])
            back.append({"run": folder.id, "folder": str(folder.path)})
            for problem in record.problems:
                print(f"warning: {clean(folder.id)}: {clean(problem)}", file=sys.stderr)
    _tell(back, json=json)


def _tell(moved: list[dict[str, str]], *, json: bool) -> None:
    if json:
        rows(moved, json=True)
        return
    for row in moved:
        print(f"{clean(row['run'])} -> {clean(row['folder'])}")
