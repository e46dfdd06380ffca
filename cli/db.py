"""`karolos db`: rebuilds, checks and upgrades the results database."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from karolos.errors import StoreError
from karolos.report.tables import counted

from .arguments import Database, Json, Runs
from .output import print_rows, say, warn

if TYPE_CHECKING:
    from karolos.store import Store

app = typer.Typer(name="db", help="Rebuild, check and upgrade the results database.", no_args_is_help=True)


@app.command()
def reindex(runs: Runs = Path("runs"), database: Database = None) -> None:
    """Rebuild the database from the run folders. Exit code 1 if files are damaged; the other runs are still read."""
    from karolos.store import Store
    from karolos.store.folders import check_folder

    check_folder(runs)
    with Store(database or Store.default_url(runs)) as store:
        _rebuild(store, runs)


def _rebuild(store: Store, runs: Path) -> None:
    from karolos.store import reindex as rebuild

    done = rebuild(store, runs)
    for problem in done.problems:
        warn(problem)
    say(f"{counted(done.runs, 'run')} entered, {done.forgotten} forgotten")
    if done.problems:
        raise typer.Exit(1)


@app.command()
def check(runs: Runs = Path("runs"), database: Database = None, json: Json = False) -> None:
    """List differences between the database and the run folders, and damaged files. Exit code 4 if there are any."""
    from karolos.store import Store
    from karolos.store import check as differences

    with Store(_existing(runs, database)) as store:
        found = [one.row() for one in differences(store, runs)]
    print_rows(found, json=json)
    if found:
        say(f"{counted(len(found), 'difference')}; `karolos db reindex` corrects the database, but changes no folder")
        raise typer.Exit(StoreError.exit_code)
    say("the database agrees with the run folders")


@app.command()
def upgrade(runs: Runs = Path("runs"), database: Database = None) -> None:
    """Upgrade the database of an older karolos: replace its tables and read the runs from their folders again."""
    from karolos.store import Store

    with Store(_existing(runs, database), upgrade=True) as store:
        if store.forgotten is None:
            say("nothing to do: this karolos reads the database as it is")
            return
        try:
            _rebuild(store, runs)
        finally:
            entered = {run.run for run in store.runs()}
            for run in sorted(store.forgotten - entered):
                warn(f"{run}: its folder is not in {runs}; `karolos db reindex --runs FOLDER` enters runs of another")


def _existing(runs: Path, database: str | None) -> str:
    from karolos.store import Store
    from karolos.store.folders import check_folder

    check_folder(runs)  # as an empty one, a missing one would agree with everything, or lose all runs
    url = database or Store.default_url(runs)
    if not Store.exists(url):
        raise StoreError("there is no database", where=str(runs), hint="`karolos db reindex` makes one")
    return url
