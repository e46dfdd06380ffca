"""`karolos run` and `karolos resume`: train what a spec describes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from karolos.system import detached
from karolos.system.files import writing

from .arguments import (
    Database,
    IfNeeded,
    Jobs,
    Json,
    On,
    OneRun,
    Overrides,
    Quiet,
    Resume,
    Runs,
    SpecFile,
    TimeLimit,
    in_folder,
    open_run,
    seconds,
    with_launcher,
)
from .output import print_rows, print_table, say

if TYPE_CHECKING:
    from karolos.launchers.experiment import Outcome


def run(
    spec: SpecFile,
    overrides: Overrides = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    jobs: Jobs = None,
    resume: Resume = False,
    if_needed: IfNeeded = False,
    on: On = None,
    detach: Annotated[
        bool, typer.Option("--detach", help="Run in the background. The output goes to NAME.log in the runs folder.")
    ] = False,
    time_limit: TimeLimit = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Train and test what SPEC describes, once per seed.

    Each run writes a folder in the runs folder and an entry in the database. Ctrl-C finishes the step, writes a
    checkpoint and stops. A second Ctrl-C stops at once.
    """
    from karolos.specification import load_spec

    found, longest = load_spec(spec, with_launcher(overrides, on)), seconds(time_limit)
    if detach:
        from karolos.experiment.check import check_parts

        check_parts(found)
        _detach(runs, f"{found.name}.log")
    from karolos.launchers.experiment import Experiment

    from .display import choose_display

    with choose_display(quiet=quiet) as display:
        outcome = Experiment(found).run(
            runs,
            database=database,
            jobs=jobs,
            existing="resume" if resume else "skip" if if_needed else "ignore",
            time_limit=longest,
            listener=display,
            check=False,
        )
    report(outcome, runs, quiet=quiet, json=json)


def _detach(runs: Path, name: str) -> NoReturn:
    """Start this command in the background, with its output in a log, and end this process. Raises MachineError."""
    log, option = runs / name, in_folder(runs)
    words = [word for word in sys.argv[1:] if word != "--detach"]
    with writing(log):
        log.parent.mkdir(parents=True, exist_ok=True)
        out = log.open("ab")
    command = [sys.executable, "-m", "karolos_cli", *words]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=out, **detached())
    say(f"process {process.pid} goes on, with its output in {log}")
    stops = f"`karolos runs stop RUN{option}` stops one with a checkpoint"
    say(f"`karolos runs list --watch{option}` shows the runs, {stops}")
    raise typer.Exit


More = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[PATH=VALUE]...", help="For a finished run: its new number of steps, e.g. training.steps=50000."
    ),
]


def resume(
    run: OneRun,
    overrides: More = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    time_limit: TimeLimit = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Resume a run that was stopped, failed or killed, from its newest checkpoint.

    On the CPU and in lockstep the result is the same, bit for bit, as without the interruption. With
    training.steps=... a finished run goes on: karolos copies it to a new run, which trains to this number of steps.
    """
    from karolos.launchers.experiment import resume_run
    from karolos.store import Store

    from .display import choose_display

    folder = open_run(run, runs, database)
    home = folder.path.resolve().parent
    if folder.state().state == "finished" and not overrides and not quiet:
        say(f"{folder.id} is finished: nothing to do; training.steps=... goes on from its end")
    with choose_display(quiet=quiet) as display:
        outcome = resume_run(
            folder,
            database or Store.default_url(home),
            overrides or (),
            time_limit=seconds(time_limit),
            listener=display,
        )
    report(outcome, home, quiet=quiet, json=json)


def report(outcome: Outcome, runs: Path, *, quiet: bool, json: bool) -> NoReturn:
    """Print the runs and end with the outcome's exit code."""
    if not outcome.runs:
        say("stopped before a run began")
    if json:
        print_rows([summary.row() for summary in outcome.runs], json=True)
    elif outcome.runs and not quiet:
        from karolos.records import RunFolder
        from karolos.records.shipped import SHIPPED, is_shipped
        from karolos.report.tables import runs_table

        print_table(runs_table(outcome.runs))
        last, option = outcome.runs[-1], in_folder(runs)
        folder = RunFolder(Path(last.folder))
        shown = f"{SHIPPED}{folder.path.name}" if is_shipped(folder) else f"{last.run}{option}"
        plays = f", `karolos play {shown}` shows it" if last.mean_return is not None else ""
        say(f"results in {runs}; `karolos runs show {shown}` shows more{plays}")
        for run in (run for run in outcome.runs if run.state in ("stopped", "lost")):
            say(f"{run.run} is {run.state}: `karolos resume {run.run}{option}` continues it")
    raise typer.Exit(outcome.exit_code)
