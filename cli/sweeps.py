"""`karolos sweeps`: which sweeps there are, and what came of their trials."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from karolos.errors import UsageError
from karolos.report.terminal import clean

from .common import Database, Json, Runs, rows
from .selection import open_store
from .sweep_output import drawn_text, tell_final, trial_row, where_next

if TYPE_CHECKING:
    from karolos.records.sweep_records import SweepRecord

app = typer.Typer(name="sweeps", help="List sweeps, and show the trials of one.", no_args_is_help=True)


@app.command("list")
def list_sweeps(runs: Runs = Path("runs"), database: Database = None, json: Json = False) -> None:
    """List sweeps, the newest first: how far they are, and the best trial by the first objective."""
    store = open_store(runs, database)
    found: tuple[SweepRecord, ...] = ()
    if store is not None:
        with store:
            found = store.sweeps.all()
    if not found:
        print(f"no sweeps in {runs} yet; `karolos sweep SPEC` makes one", file=sys.stderr)
    rows([sweep.row() if json else _line(sweep) for sweep in found], json=json)


@app.command()
def show(
    name: Annotated[str, typer.Argument(metavar="NAME", help="A sweep's name or id.")],
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Show a sweep: every trial with its objectives, settings and runs, and how far to trust the best."""
    store = open_store(runs, database)
    if store is None:
        raise UsageError(f"there is no sweep {name!r}", hint="`karolos sweep SPEC` makes one")
    with store:
        sweep = store.sweeps.find(name)
    if json:
        rows([sweep.row()], json=True)
        return
    resting = sweep.state() != "running"
    found = [trial_row(trial, sweep.objectives, sweep.parameters, sweep.final) for trial in sweep.trials]
    # A trial of a sweep that was interrupted waits for the next call: nobody works on it.
    rows([row | {"state": "open"} if resting and row["state"] == "running" else row for row in found], json=False)
    print(
        clean(f"{sweep.sweep} {sweep.state()}, {sweep.ended} of {sweep.asked} trials, {sweep.folder}"), file=sys.stderr
    )
    if sweep.best is None:
        print("no trial is complete yet", file=sys.stderr)
        return
    print(clean(f"best: trial {sweep.best.number}, {drawn_text(sweep.best)}"), file=sys.stderr)
    if sweep.final is not None:
        tell_final(sweep.final, sweep.objectives)
    if (Path(sweep.folder) / "best.yaml").is_file():
        where_next(Path(sweep.folder))


def _line(sweep: SweepRecord) -> dict[str, Any]:
    best = sweep.best
    return {
        "sweep": sweep.sweep,
        "state": sweep.state(),
        "trials": f"{sweep.ended}/{sweep.asked}",
        "objective": sweep.objectives[0],
        "best": best.values[0] if best and best.values else None,
        "trial": best.number if best else None,
        "settings": drawn_text(best) if best else None,
    }
