"""`karolos db`: the results database and whether it agrees with the run folders."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from karolos.errors import StoreError
from karolos.report.terminal import clean

from .common import Database, Json, Runs, rows

if TYPE_CHECKING:
    from karolos.store import Store

app = typer.Typer(name="db", help="Rebuild, check and upgrade the results database.", no_args_is_help=True)
Jobs = Annotated[
    int | None,
    typer.Option(min=1, help="Processes that read folders; one per core by default.", show_default=False),
]


@app.command()
def reindex(runs: Runs = Path("runs"), database: Database = None, jobs: Jobs = None) -> None:
    """Rebuild the database from the run folders, which are the truth."""
    from karolos.store import Store

    with Store(database or Store.default_url(runs)) as store:
        _reindex(store, runs, jobs)


@app.command()
def check(runs: Runs = Path("runs"), database: Database = None, jobs: Jobs = None, json: Json = False) -> None:
    """List where the database and the run folders differ, and what is damaged; exit code 4 if anything is."""
    from karolos.store import Store
    from karolos.store import check as differences

    url = database or Store.default_url(runs)
    if not Store.exists(url):
        raise StoreError("there is no database", where=str(runs), hint="`karolos db reindex` makes one")
    with Store(url) as store:
        found = [one.row() for one in differences(store, runs, jobs=jobs or _cores())]
    rows(found, json=json)
    if found:
        print(f"{len(found)} differences; `karolos db reindex` puts right what the folders tell", file=sys.stderr)
        raise typer.Exit(StoreError.exit_code)
    print("the database agrees with the run folders", file=sys.stderr)


@app.command()
def upgrade(runs: Runs = Path("runs"), database: Database = None, jobs: Jobs = None) -> None:
    """Bring a database of an older karolos up to date, after a copy of it; then fill in what the folders know."""
    from karolos.store import Store
    from karolos.store.upgrade import upgrade as upgrade_database

    url = database or Store.default_url(runs)
    done = upgrade_database(url)
    if done.before == done.after:
        print(f"nothing to do: the database has schema {done.after}", file=sys.stderr)
        return
    print(f"from schema {done.before} to {done.after}", file=sys.stderr)
    if done.backup is not None:
        print(f"the database as it was: {done.backup}", file=sys.stderr)
    with Store(url) as store:
        _reindex(store, runs, jobs)


def _reindex(store: Store, runs: Path, jobs: int | None) -> None:
    from karolos.store import reindex as rebuild

    done = rebuild(store, runs, jobs=jobs or _cores())
    for problem in done.problems:
        print(f"warning: {clean(problem)}", file=sys.stderr)
    print(f"{done.runs} runs entered, {done.forgotten} forgotten", file=sys.stderr)
    if done.sweeps or done.forgotten_sweeps:
        print(f"{done.sweeps} sweeps entered, {done.forgotten_sweeps} forgotten", file=sys.stderr)


def _cores() -> int:
    from karolos.orchestrator.probe import cores

    return cores()
