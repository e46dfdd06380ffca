"""`karolos run` and `karolos resume`: train what a spec describes."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from karolos.errors import KarolosError
from karolos.files import writing

from .arguments import (
    Database,
    Json,
    On,
    OneRun,
    Overrides,
    Quiet,
    Runs,
    TimeLimit,
    open_run,
    seconds,
    with_launcher,
)
from .output import print_rows, print_table, say

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from karolos.experiment.events import RunEvent
    from karolos.launchers.experiment import Outcome


def run(
    spec: Annotated[Path, typer.Argument(metavar="SPEC", help="The YAML spec to run.")],
    overrides: Overrides = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            min=1, help="Seeds to run at the same time, each in its own process. Default: 1, or all with --on."
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Resume interrupted runs of this spec; skip finished seeds.")
    ] = False,
    if_needed: Annotated[bool, typer.Option("--if-needed", help="Skip seeds that are finished.")] = False,
    on: On = None,
    detach: Annotated[
        bool, typer.Option("--detach", help="Go on in the background; the output is in NAME.log in the runs folder.")
    ] = False,
    time_limit: TimeLimit = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Train and test what SPEC describes, once per seed.

    Each run writes a folder in the runs folder and an entry in the database. Ctrl-C finishes the step, writes a
    checkpoint and stops the run. A second Ctrl-C ends it at once.
    """
    if jobs in (None, 1) and on is None and not detach:
        _start_workers(spec, overrides or ())
    from karolos.spec import load_spec

    found = load_spec(spec, with_launcher(overrides, on))
    is_launched = _detached(runs / f"{found.name}.log") if detach else None
    from karolos.launchers.experiment import Experiment

    from .display import choose_display

    with choose_display(quiet=quiet) as display:

        def listen(event: RunEvent) -> None:
            if is_launched is not None:
                is_launched()
            display(event)

        outcome = Experiment(found).run(
            runs,
            database=database,
            jobs=jobs,
            existing="resume" if resume else "skip" if if_needed else "ignore",
            time_limit=seconds(time_limit),
            listener=listen,
            text=spec.read_text("utf-8"),
            check=False,
        )
    report(outcome, runs, quiet=quiet, json=json)


def _detached(log: Path) -> Callable[[], None]:
    """Continue in a process without a terminal, which writes into the log.

    The first process ends when the second calls what this returns, or with the exit code and output of the second if
    that one ends before.

    Raises:
        MachineError: the log cannot be written.
    """
    with writing(log):
        log.parent.mkdir(parents=True, exist_ok=True)
        out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
        start = os.fstat(out).st_size
    read, write = os.pipe()
    process = os.fork()
    if process == 0:
        os.setsid()
        for target, source in ((0, os.open(os.devnull, os.O_RDONLY)), (1, out), (2, out)):
            os.dup2(source, target)
        os.close(read)
        ends = [write]

        def is_launched() -> None:
            if ends:
                os.write(ends[0], b".")
                os.close(ends.pop())

        return is_launched
    os.close(write)
    if os.read(read, 1):
        say(f"process {process} goes on, with its output in {log}; `kill {process}` stops it with checkpoints")
        say("`karolos runs list --watch` shows the runs")
        raise typer.Exit
    _, status = os.waitpid(process, 0)
    sys.stderr.write(log.read_bytes()[start:].decode(errors="replace"))
    raise typer.Exit(os.waitstatus_to_exitcode(status))


def _start_workers(spec: Path, overrides: Sequence[str]) -> None:
    """Start the server of the worker processes while this process imports the agent, which takes longer."""
    from karolos.orchestrator.start import start_server
    from karolos.spec.files import SpecFiles, named_plugins

    with suppress(KarolosError):  # `load_spec` reports it
        tree = SpecFiles(spec).load()
        processes, plugins = tree.get("orchestrator", "processes"), named_plugins(tree)
        if (processes is None or processes.value != 0) and not any(one.startswith("orchestrator") for one in overrides):
            parts = [plugins[key] for key in ("environment", "robot", "task") if key in plugins]
            start_server([part.target.partition(":")[0] for part in parts])


def resume(
    run: OneRun,
    runs: Runs = Path("runs"),
    database: Database = None,
    time_limit: TimeLimit = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Resume a run that was stopped, failed or killed, from its newest checkpoint.

    On the CPU and in lockstep the result is bit for bit that of a run without the interruption.
    """
    from karolos.launchers.experiment import resume_run
    from karolos.store import Store

    from .display import choose_display

    folder = open_run(run, runs, database)
    home = folder.path.resolve().parent
    if folder.state().state == "finished" and not quiet:
        say(f"{folder.id} is finished: nothing to do")
    with choose_display(quiet=quiet) as display:
        outcome = resume_run(
            folder, database or Store.default_url(home), time_limit=seconds(time_limit), listener=display
        )
    report(outcome, home, quiet=quiet, json=json)


def report(outcome: Outcome, runs: Path, *, quiet: bool, json: bool) -> NoReturn:
    """Print the runs and end with the outcome's exit code."""
    if json:
        print_rows([summary.row() for summary in outcome.runs], json=True)
    elif outcome.runs and not quiet:
        from karolos.report.tables import runs_table

        print_table(runs_table(outcome.runs))
        last = outcome.runs[-1]
        plays = ", `karolos play @last` shows it" if last.mean_return is not None else ""
        say(f"results in {runs}; `karolos runs show {last.run}` shows more{plays}")
        stopped = [run.run for run in outcome.runs if run.state == "stopped"]
        for run in stopped:
            say(f"{run} is stopped: `karolos resume {run}` continues it")
    raise typer.Exit(outcome.exit_code)
