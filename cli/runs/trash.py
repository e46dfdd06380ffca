"""`karolos runs rm` and `restore`: into the trash and out of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import UsageError

from ..arguments import Database, Json, ManyRuns, Runs, Where, open_store, select_runs
from ..output import print_line, print_rows, say, warn


def remove(
    run: ManyRuns = None,
    where: Where = None,
    purge: Annotated[bool, typer.Option("--purge", help="Empty the trash for good. Takes no RUN.")] = False,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Move runs to the trash (.trash in the runs folder). `karolos runs restore` brings them back."""
    from karolos.records import RunFolder, trash

    if purge:
        if run or where:
            raise UsageError("--purge empties the trash and takes no RUN", hint="first rm RUN, then rm --purge")
        paths = trash.thrown_away(runs)
        for path in paths:
            trash.purge(path)
        say(f"{len(paths)} runs removed for good")
        return
    store, found = select_runs(run or (), where, runs, database)
    with store:
        moved = []
        for summary in found:
            path = trash.throw_away(RunFolder.open(summary.folder))
            store.remove_runs([summary.run])
            moved.append({"run": summary.run, "folder": str(path)})
    _print_moved(moved, json=json)
    say("`karolos runs restore RUN` brings them back, `karolos runs rm --purge` empties the trash")


def restore(
    run: Annotated[
        list[str], typer.Argument(metavar="RUN...", help="The run's id or its beginning.", show_default=False)
    ],
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Move runs out of the trash, with their tests, tags and note."""
    from karolos.records import trash
    from karolos.store import Store

    paths = list(dict.fromkeys(trash.find(runs, selector) for selector in run))
    moved = []
    with open_store(runs, database) or Store(database or Store.default_url(runs)) as store:
        for path in paths:
            folder = trash.restore(path)
            record = folder.record()
            store.add_records([record])
            moved.append({"run": folder.id, "folder": str(folder.path)})
            for problem in record.problems:
                warn(f"{folder.id}: {problem}")
    _print_moved(moved, json=json)


def _print_moved(moved: list[dict[str, str]], *, json: bool) -> None:
    if json:
        print_rows(moved, json=True)
        return
    for row in moved:
        print_line(f"{row['run']} -> {row['folder']}")
