"""`karolos run` and `karolos resume`: specs into results."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from karolos.errors import UsageError

from .common import RUN_HELP, Database, Json, Overrides, Runs, print_rich, rows
from .selection import open_run

if TYPE_CHECKING:
    from karolos.experiment.experiment import Outcome

TimeLimit = Annotated[
    str | None,
    typer.Option(
        metavar="DURATION",
        help="Stop after this long with a checkpoint to go on from, e.g. 90s, 30m, 2h; exit code 124.",
        show_default=False,
    ),
]


def run(
    spec: Annotated[Path, typer.Argument(metavar="SPEC", help="The YAML spec to run.", show_default=False)],
    overrides: Overrides = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    jobs: Annotated[int, typer.Option(min=1, help="Seeds to run at the same time, each in its own process.")] = 1,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with runs of this spec that ended too soon; finished seeds stay.")
    ] = False,
    if_needed: Annotated[bool, typer.Option("--if-needed", help="Leave out seeds that are finished.")] = False,
    time_limit: TimeLimit = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Show warnings and failures only.")] = False,
    json: Json = False,
) -> None:
    """Train and test what SPEC describes, once for each of its seeds.

    Results go below the runs folder, one folder per run, and into the database. Ctrl-C finishes the step, writes a
    checkpoint and leaves the run stopped; pressed twice it ends at once.
    """
    from karolos.spec import load_spec

    found = load_spec(spec, overrides or ())
    from karolos.experiment.experiment import Experiment

    from .display import choose_display

    with choose_display(quiet=quiet) as display:
        outcome = Experiment(found).run(
            runs,
            database=database,
            jobs=jobs,
            existing="resume" if resume else "skip" if if_needed else "ignore",
            time_limit=seconds(time_limit),
            listener=display,
            text=spec.read_text("utf-8"),
            check=False,
        )
    report(outcome, runs, quiet=quiet, json=json)


def resume(
    run: Annotated[str, typer.Argument(metavar="RUN", help=RUN_HELP, show_default=False)],
    runs: Runs = Path("runs"),
    database: Database = None,
    time_limit: TimeLimit = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Show warnings and failures only.")] = False,
    json: Json = False,
) -> None:
    """Go on with a run that was stopped, failed or died, from its newest checkpoint.

    What it computes is bit for bit what it would have computed without the break (on the CPU, in lockstep).
    """
    from karolos.experiment.experiment import resume_run
    from karolos.store import Store

    from .display import choose_display

    folder = open_run(run, runs, database)
    home = folder.path.resolve().parent
    with choose_display(quiet=quiet) as display:
        outcome = resume_run(
            folder, database or Store.default_url(home), time_limit=seconds(time_limit), listener=display
        )
    report(outcome, home, quiet=quiet, json=json)


def report(outcome: Outcome, runs: Path, *, quiet: bool, json: bool) -> NoReturn:
    """Print what became of the runs and end with the outcome's exit code."""
    if json:
        rows([summary.row() for summary in outcome.runs], json=True)
    elif outcome.runs and not quiet:
        from karolos.report.tables import runs_table

        print_rich(runs_table(outcome.runs))
        last = outcome.runs[-1]
        plays = ", `karolos play @last` shows it" if last.success_any is not None else ""
        print(f"\nresults in {runs}; `karolos runs show {last.run}` tells more{plays}", file=sys.stderr)
    raise typer.Exit(outcome.exit_code)


def seconds(text: str | None) -> float | None:
    """A duration such as 90, 90s, 30m, 2h or 1d in seconds. Raises UsageError for anything else."""
    if text is None:
        return None
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([smhd]?)", text.strip())
    if found is None or float(found[1]) <= 0:
        raise UsageError(f"{text!r} is no duration", where="--time-limit", hint="write e.g. 90s, 30m, 2h or 1d")
    return float(found[1]) * {"": 1, "s": 1, "m": 60, "h": 3600, "d": 86400}[found[2]]
