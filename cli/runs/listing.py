"""`karolos runs list`: the runs that fit, as a table, JSON or CSV."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import UsageError

from ..common import Database, Json, Runs, csv_rows, print_rich, rows
from ..selection import FILTER_HELP, open_store


def list_runs(
    where: Annotated[str | None, typer.Argument(metavar="[FILTER]", help=FILTER_HELP, show_default=False)] = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
    csv: Annotated[bool, typer.Option("--csv", help="Comma-separated values with a line of names.")] = False,
    state: Annotated[
        str | None, typer.Option(help="Only runs that are created, running, finished, failed, stopped or lost.")
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Not more than that many, the newest first.")] = None,
    trash: Annotated[bool, typer.Option("--trash", help="Runs that `karolos runs rm` has thrown away.")] = False,
) -> None:
    """List runs, the newest first; with a filter only those that fit."""
    if trash:
        _list_trash(runs, json=json, other=where or state or csv)
        return
    store = open_store(runs, database)
    if store is None:
        print(f"no runs in {runs} yet; `karolos run SPEC` makes one", file=sys.stderr)
        return
    with store:
        found = store.runs(state=state, where=where, limit=limit)
    if json or csv:
        table = [run.row() for run in found]
        rows(table, json=True) if json else csv_rows(table)
    elif found:
        from karolos.report.tables import runs_table

        print_rich(runs_table(found))
    elif where is not None:
        print("no runs fit the filter", file=sys.stderr)
    else:
        print("no runs" + (f" are {state}" if state else " yet"), file=sys.stderr)


def _list_trash(runs: Path, *, json: bool, other: object) -> None:
    from karolos.records import trash

    if other:
        raise UsageError("--trash takes no filter, state or --csv", hint="`karolos runs restore RUN` brings one back")
    found = trash.thrown_away(runs)
    if json:
        rows([{"run": path.name, "folder": str(path)} for path in found], json=True)
        return
    for path in found:
        print(path.name)
    if not found:
        print(f"there are no runs in the trash of {runs}", file=sys.stderr)
