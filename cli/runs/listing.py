"""`karolos runs list`: runs as a table, JSON or CSV."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import UsageError
from karolos.report.tables import runs_table

from ..arguments import FILTER_HELP, Database, Json, Runs, open_store
from ..output import print_csv, print_line, print_rows, print_table, say


def list_runs(
    where: Annotated[str | None, typer.Argument(metavar="[FILTER]", help=FILTER_HELP, show_default=False)] = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
    csv: Annotated[bool, typer.Option("--csv", help="Print comma-separated values with a line of names.")] = False,
    state: Annotated[
        str | None, typer.Option(help="Only runs that are created, running, finished, failed, stopped or lost.")
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Only this number of runs, the newest.")] = None,
    trash: Annotated[bool, typer.Option("--trash", help="List the runs in the trash instead.")] = False,
) -> None:
    """List runs, the newest first."""
    if trash:
        _list_trash(runs, json=json, other=where or state or csv)
        return
    store = open_store(runs, database)
    if store is None:
        say(f"no runs in {runs} yet; `karolos run SPEC` makes one")
        return
    with store:
        found = store.runs(state=state, where=where, limit=limit)
    if json:
        print_rows([run.row() for run in found], json=True)
    elif csv:
        print_csv([run.row() for run in found])
    elif found:
        print_table(runs_table(found))
    elif where is not None:
        say("no runs match the filter")
    else:
        say("no runs" + (f" are {state}" if state else " yet"))


def _list_trash(runs: Path, *, json: bool, other: object) -> None:
    from karolos.records import trash

    if other:
        raise UsageError("--trash takes no filter, state or --csv", hint="`karolos runs restore RUN` brings a run back")
    paths = trash.thrown_away(runs)
    if not paths:
        say(f"there are no runs in the trash of {runs}")
    if json:
        print_rows([{"run": path.name, "folder": str(path)} for path in paths], json=True)
        return
    for path in paths:
        print_line(path.name)
