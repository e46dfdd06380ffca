"""`karolos db`: the results database and whether it agrees with the run folders."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import StoreError
from karolos.report.terminal import clean

from .common import Database, Json, Runs, rows

app = typer.Typer(name="db", help="Rebuild, check and upgrade the results database.", no_args_is_help=True)
Jobs = Annotated[
    int | None,
    typer.Option(min=1, help="Processes that read folders; one per core by default.", show_default=False),
]


@app.command()
def reindex(runs: Runs = Path("runs"), database: Database = None, jobs: Jobs = None) -> None:
    """Rebuild the database from the run folders, which are the truth."""
    from karolos.store import Store
    from karolos.store import reindex as rebuild

    with Store(database or Store.default_url(runs)) as store:
        done = rebuild(store, runs, jobs=jobs or _cores())
    for problem in done.problems:
        print(f"warning: {clean(problem)}", file=sys.stderr)
    print(f"{done.runs} runs entered, {done.forgotten} forgotten", file=sys.stderr)
    if done.sweeps or done.forgotten_sweeps:
        print(f"{done.sweeps} sweeps entered, {done.forgotten_sweeps} forgotten", file=sys.stderr)


@app.command()
def check(runs: Runs = Path("runs"), database: Database = None, jobs: Jobs = None, json: Json = False) -> None:
    """List where the database and the run folders differ, and what is damaged; exit code 4 if anything is."""
    from karolos.store import Store
    from karolos.store import check as differences

    with Store(_existing(runs, database)) as store:
        found = [one.row() for one in differences(store, runs, jobs=jobs or _cores())]
    rows(found, json=json)
    if found:
        print(f"{len(found)} differences; `karolos db reindex` enters what the folders hold", file=sys.stderr)
        raise typer.Exit(StoreError.exit_code)
    print("the database agrees with the run folders", file=sys.stderr)


@app.command()
def upgrade(runs: Runs = Path("runs"), database: Database = None) -> None:
    """Say whether this karolos can read the database; one of another version is rebuilt by `karolos db reindex`."""
    from karolos.store import Store

    Store(_existing(runs, database)).close()
    print("nothing to do: this karolos reads the database as it is", file=sys.stderr)


def _existing(runs: Path, database: str | None) -> str:
    from karolos.store import Store

    url = database or Store.default_url(runs)
    if not Store.exists(url):
        raise StoreError("there is no database", where=str(runs), hint="`karolos db reindex` makes one")
    return url


def _cores() -> int:
    from karolos.orchestrator.auto import cores

    return cores()
