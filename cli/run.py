"""`karolos run`: specs into results."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from .common import Database, Json, Runs, print_rich, rows


def run(
    spec: Annotated[Path, typer.Argument(metavar="SPEC", help="The YAML spec to run.", show_default=False)],
    overrides: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[PATH=VALUE]...",
            help="Settings that replace the spec's, e.g. agent.learning_rate=1e-4 seeds=[0,1].",
            show_default=False,
        ),
    ] = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    jobs: Annotated[int, typer.Option(min=1, help="Seeds to run at the same time, each in its own process.")] = 1,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Show warnings and failures only.")] = False,
    json: Json = False,
) -> None:
    """Train and test what SPEC describes, once for each of its seeds.

    Results go below the runs folder, one folder per run, and into the database. Ctrl-C finishes the step, writes a
    checkpoint and leaves the run stopped; pressed twice it ends at once.
    """
    from karolos.spec import load_spec

    found = load_spec(spec, overrides or ())
    from karolos.experiment import Experiment

    from .display import choose_display

    with choose_display(quiet=quiet) as display:
        outcome = Experiment(found).run(
            runs, database=database, jobs=jobs, listener=display, text=spec.read_text("utf-8"), check=False
        )
    if json:
        rows([summary.row() for summary in outcome.runs], json=True)
    elif outcome.runs and not quiet:
        from karolos.report.tables import runs_table

        print_rich(runs_table(outcome.runs))
        last = outcome.runs[-1]
        print(
            f"\nresults in {runs}; `karolos runs show {last.run}` tells more, `karolos play @last` shows it",
            file=sys.stderr,
        )
    raise typer.Exit(outcome.exit_code)
