"""`karolos sweep`, `karolos suite` and `karolos transfer`: runs that are executed and reported together.

`karolos sweeps` shows the sweeps and their trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from karolos.errors import KarolosError, UsageError
from karolos.report.tables import counted

from .arguments import (
    Database,
    IfNeeded,
    Jobs,
    Json,
    On,
    Overrides,
    Quiet,
    Resume,
    Runs,
    SpecFile,
    TimeLimit,
    seconds,
    with_launcher,
)
from .completion import complete_folder, complete_spec
from .output import check_folder, drawn_text, print_report, print_rows, say, short_text, warn

if TYPE_CHECKING:
    from karolos.launchers.experiment import Outcome
    from karolos.plans.plan import Plan
    from karolos.plans.sweep import Search
    from karolos.records.sweep_records import SweepRecord, Trial

app = typer.Typer(name="sweeps", help="List sweeps, and show their trials.", no_args_is_help=True)
SAMPLES = 5
"""Largest number of sampled specs that --dry-run prints."""


def _run(plan: Plan, shown: AbstractContextManager[Any], runs: Path, time_limit: str | None, **how: Any) -> Outcome:
    """Run the missing runs of a plan. After a stop a line says how to continue, and a suite or a matrix ends here."""
    longest = seconds(time_limit)
    with shown as listener:
        outcome = plan.run(runs, listener=listener, time_limit=longest, **how)
    if outcome.stop_code and not outcome.complete:
        say(f"{plan.name} is stopped: the same command {'with --resume ' if 'existing' in how else ''}continues it")
        if "existing" in how:
            raise typer.Exit(outcome.exit_code)
    return outcome


def sweep(
    spec: SpecFile,
    overrides: Overrides = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    trials: Annotated[
        int | None, typer.Option(min=1, help="Number of trials in total. Default: as in the spec.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Trials at the same time. Each seed is a process.")] = 1,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check the search and print its first trials.")] = False,
    on: On = None,
    time_limit: TimeLimit = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Search the settings that SPEC's sweep names, and write the best ones as a spec.

    Each trial is the spec with other values. Its runs, one per seed of the sweep, are ordinary runs. The same command
    resumes an interrupted sweep. The sweep's folder is sweeps/NAME in the runs folder. It holds best.yaml.
    """
    from karolos.specification import load_spec

    found = load_spec(spec, with_launcher(overrides, on))
    from karolos.plans.sweep import Search

    from . import display

    search = Search(found, trials=trials)
    if dry_run:
        _print_samples(search, json=json)
        return
    shown = display.Quiet() if quiet else display.SweepDisplay(search.sweep.objectives)
    outcome = _run(search, shown, runs, time_limit, database=database, jobs=jobs)
    if search.record is not None:
        report_sweep(search.record, search.front, quiet=quiet, json=json)
    raise typer.Exit(outcome.exit_code)


def report_sweep(sweep: SweepRecord, front: Sequence[Trial], *, quiet: bool, json: bool) -> None:
    """Print the trials on stdout, and the best of them on stderr."""
    if json:
        print_rows((_trial_row(one, sweep) for one in sweep.trials), json=True)
    elif not quiet:
        print_trials(sweep)
    if not quiet:
        for trial in front if len(sweep.objectives) > 1 else ():
            say(f"no trial is better than trial {trial.number} in every objective: {drawn_text(trial)}")
        report_best(sweep)


def _trial_row(trial: Trial, sweep: SweepRecord) -> dict[str, Any]:
    """A trial as a row: state, objectives, settings, error, runs.

    After the final choice each objective has two more columns: `fresh` on the seeds of the choice, and `unused` on the
    reporting seeds, which only the chosen trial has.
    """
    row: dict[str, Any] = {"trial": trial.number, "state": trial.state}
    final = sweep.final
    for place, name in enumerate(sweep.objectives):
        row[name] = trial.values[place] if trial.values else None
        if final is not None:
            fresh = final.fresh.get(trial.number)
            row[f"{name}_fresh"] = fresh[place] if fresh else None
            unused = final.reported if trial.number == final.chosen else None
            row[f"{name}_unused"] = unused[place] if unused else None
    settings = {key: trial.drawn.get(key) for key in sweep.parameters}  # None: not sampled by the trial
    return {**row, **settings, "error": trial.error, "runs": list(trial.runs)}


def print_trials(sweep: SweepRecord) -> None:
    """Print a table of trials, without runs, errors and `unused`.

    A trial that has not ended is `open` unless the sweep is running: it waits until the sweep is resumed.
    """
    running = sweep.state() == "running"
    left_out = ("error", "runs", *(f"{name}_unused" for name in sweep.objectives))
    rows = []
    for row in (_trial_row(trial, sweep) for trial in sweep.trials):
        row["state"] = "open" if row["state"] == "running" and not running else row["state"]
        rows.append({name: short_text(value, 3) for name, value in row.items() if name not in left_out})
    print_rows(rows, json=False)


def report_best(sweep: SweepRecord) -> None:
    """Print the best trial on stderr: its settings, its results by seeds, and the command to run it."""
    best, final, path = sweep.best, sweep.final, Path(sweep.folder) / "best.yaml"
    if best is None:
        say("no trial is complete yet")
        return
    say(f"best: trial {best.number}, {drawn_text(best)}")
    if final is not None:
        for place, name in enumerate(sweep.objectives):
            tuned, fresh = final.tuned[place], final.fresh[final.chosen][place]
            line = f"{name}: {tuned:.4g} on the seeds of tuning, {fresh:.4g} on "
            line += f"{counted(len(final.seeds), 'new seed')} of the choice"
            if final.reported is not None:
                unused = final.reported[place]
                held_out = counted(len(final.report_seeds), "held-out seed")
                line += f", {unused:.4g} on {held_out}: gap {tuned - unused:+.4g}"
            say(line)
    if path.is_file():
        say(f"`karolos run {path}` runs it; figures in {path.parent}")


def _print_samples(search: Search, *, json: bool) -> None:
    """Print the first trials: the changed settings, and whether the spec with them is valid.

    Raises UsageError as the search itself if its parts are incompatible, or the environment lacks an objective.
    """
    from karolos.experiment.check import check_parts
    from karolos.plans.study import STARTUP_TRIALS

    if (note := check_parts(search.spec)) is not None:
        warn(note)
    rows = []
    for place, (drawn, made) in enumerate(search.samples(min(search.asked, SAMPLES))):
        row = {"trial": place, **{key: drawn.get(key) for key in search.sweep.space}}
        if isinstance(made, KarolosError):
            row["problem"] = str(made)
        else:
            row |= {"problem": None} | ({"spec": made.dump()} if json else {})
        rows.append(row)
    print_rows(rows, json=json)
    each = f"{counted(len(search.sweep.seeds), 'seed')} of {search.spec.training.steps:,} steps each"
    say(f"{counted(search.asked, 'trial')}, {each}; nothing was run")
    if search.sweep.sampler in ("tpe", "gp") and search.asked > STARTUP_TRIALS:
        say(f"these are the first; from trial {STARTUP_TRIALS} on, values depend on results")


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


@app.command("show")
def show_sweep(
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


def suite(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="SUITE",
            help="A YAML file that lists specs, or the name of a shipped suite.",
            autocompletion=complete_spec,
        ),
    ],
    overrides: Overrides = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    jobs: Jobs = None,
    resume: Resume = False,
    if_needed: IfNeeded = False,
    budget: Annotated[
        str | None,
        typer.Option(
            metavar="DURATION",
            help="Run one seed of each spec within this time, e.g. 2h. Specs share it in proportion to steps. A run "
            "that exceeds its share is stopped and reported as it is.",
        ),
    ] = None,
    beside: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER",
            help="Compare with the runs of the same names in this folder. `shipped`: with the shipped policies.",
        ),
    ] = None,
    on: On = None,
    time_limit: TimeLimit = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Train every spec that SUITE names, and report them as a table of tasks and robots.

    PATH=VALUE changes every spec: agent=mine trains the table with another agent. Settings that the agent does not
    know are left out and listed, and so are specs that cannot run. The runs are ordinary runs with the specs' names.
    The page is suites/NAME/report.html in the runs folder. NAME ends with the overrides, if there are any.
    """
    from karolos.specification.suite import load_suite

    found = load_suite(file, with_launcher(overrides, on))
    from karolos.plans.suite import SuitePlan
    from karolos.records.shipped import FOLDER as SHIPPED

    from . import display

    others = None if beside is None else SHIPPED if beside == "shipped" else Path(beside)
    if others is not None and not others.is_dir():
        hint = "name a folder of runs, or `shipped`"
        raise UsageError(f"there is no folder {beside}", where="--beside", hint=hint)
    plan = SuitePlan(found, overrides or (), seconds(budget, "--budget"))
    existing = "resume" if resume else "skip" if if_needed else "ignore"
    shown = display.Quiet() if quiet else display.Plain()
    outcome = _run(plan, shown, runs, time_limit, database=database, jobs=jobs, existing=existing)
    from karolos.plans import suite_report as reports

    report = reports.suite_report(plan, others)
    for warning in report.warnings:
        warn(warning)
    if not (quiet or json):
        print(reports.verdict(report))
    tables = [reports.grid_table(report), reports.entries_table(report), reports.measures_table(report)]
    print_report(report.rows(), [one for one in tables if one.rows], reports.notes(report), quiet=quiet, json=json)
    path = plan.write_page(reports.suite_page(report, plan.folder))
    if not quiet:
        say(f"wrote {path}")
    raise typer.Exit(outcome.exit_code)


def transfer(
    spec: SpecFile,
    overrides: Overrides = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    jobs: Jobs = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue a matrix. No run is repeated.")] = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Also write all figures to this folder, as SVG, PDF and PNG."),
    ] = None,
    on: On = None,
    time_limit: TimeLimit = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Train on every variant of SPEC's transfer, then test and fine-tune each policy on the other variants.

    Prints a matrix of sources and targets for each metric, and writes a page with heat maps and learning curves:
    transfers/NAME/report.html in the runs folder. The runs are ordinary runs: NAME-SOURCE, NAME-SOURCE-to-TARGET.
    """
    from karolos.specification import load_spec

    if out is not None:
        check_folder(out, "a folder")
    found = load_spec(spec, with_launcher(overrides, on))
    from karolos.plans.matrix import Matrix

    from . import display

    matrix, existing = Matrix(found), "resume" if resume else "ignore"
    shown, told = (display.Quiet(), lambda _: None) if quiet else (display.Plain(), say)
    outcome = _run(matrix, shown, runs, time_limit, database=database, jobs=jobs, existing=existing, say=told)
    from karolos.plans import matrix_report as reports
    from karolos.report.figures import write_figures

    report = reports.transfer_report(matrix)
    for warning in report.warnings:
        warn(warning)
    tables = [*(reports.matrix_table(report, name) for name in report.metrics), reports.variants_table(report)]
    tables[:0] = reports.over_targets(report)
    print_report(report.rows(), tables, reports.notes(report), quiet=quiet, json=json)
    maps, curves = reports.transfer_figures(report)
    path = matrix.write_page(reports.matrix_page(report, maps, curves, reports.pictures(matrix, report)))
    if out is not None:
        write_figures([*maps, *curves], out)
    if not quiet:
        say(f"wrote {path}")
    raise typer.Exit(outcome.exit_code)
