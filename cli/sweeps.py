"""`karolos sweeps`: the sweeps and their trials."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .arguments import Database, Json, Runs
from .completion import complete_folder
from .output import drawn_text, print_rows, say, warn
from .plans import print_trials, report_best

if TYPE_CHECKING:
    from karolos.records.sweep_records import SweepRecord

app = typer.Typer(name="sweeps", help="List sweeps, and show their trials.", no_args_is_help=True)


@app.command("list")
def list_sweeps(
    runs: Runs = Path("runs"),
    database: Database = None,  # noqa: ARG001  (sweeps are read from their folders)
    json: Json = False,
) -> None:
    """List sweeps, newest first, with their progress and the best trial by the first objective."""
    from karolos.records.sweep_records import sweeps

    found, problems = sweeps(runs)
    for problem in problems:
        warn(problem)
    if not found:
        say(f"no sweeps in {runs} yet; `karolos sweep SPEC` makes one")
    print_rows([sweep.row() if json else _short_row(sweep) for sweep in found], json=json)


@app.command()
def show(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="A sweep's name or id.", autocompletion=complete_folder("sweeps/*/sweep.json")
        ),
    ],
    runs: Runs = Path("runs"),
    database: Database = None,  # noqa: ARG001  (sweeps are read from their folders)
    json: Json = False,
) -> None:
    """Show a sweep: every trial with objectives, settings and runs, and the best trial's result on new seeds."""
    from karolos.records.sweep_records import find_sweep

    sweep = find_sweep(runs, name)
    if json:
        print_rows([sweep.row()], json=True)
        return
    print_trials(sweep)
    for trial in sweep.trials:
        if trial.error is not None:
            say(f"trial {trial.number} failed: {trial.error}")
    say(f"{sweep.sweep} {sweep.state()}, {sweep.ended} of {sweep.asked} trials, {sweep.folder}")
    report_best(sweep)


def _short_row(sweep: SweepRecord) -> dict[str, Any]:
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
