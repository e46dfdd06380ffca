"""`karolos suite`: a table of tasks and robots, trained and reported together."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from karolos.errors import UsageError

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
    TimeLimit,
    seconds,
    with_launcher,
)
from .completion import complete_spec
from .output import end_if_stopped, print_report, say, warn

FOLDER = "suites"


def suite(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="SUITE", help="A YAML file that names specs, or one that ships.", autocompletion=complete_spec
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
            help="Run one seed of each spec within this time, e.g. 2h. The specs share it by their steps; a run that "
            "does not fit is cut and reported as it is.",
        ),
    ] = None,
    beside: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER",
            help="Compare with the runs in this folder that have the specs' names; `shipped`: with those that ship.",
        ),
    ] = None,
    on: On = None,
    time_limit: TimeLimit = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Train every spec that SUITE names, and report them as a table of tasks and robots.

    PATH=VALUE holds for every spec: agent=mine trains the table with another agent, without the settings that it has no
    use for; they are said, and so is what cannot run. The runs are ordinary runs with
    the specs' names. The page is suites/NAME/report.html in the runs folder; with overrides NAME has them at its end.
    """
    from karolos.specification.suite import load_suite

    found = load_suite(file, with_launcher(overrides, on))
    others = _folder(beside)
    from karolos.launchers.suite import fitted, train

    from . import display

    found = fitted(found, jobs or 1)
    for note in found.notes:
        warn(note)

    with display.Quiet() if quiet else display.Plain() as listener:
        trained = train(
            found,
            runs,
            database=database,
            jobs=jobs,
            existing="resume" if resume else "skip" if if_needed else "ignore",
            time_limit=seconds(time_limit),
            budget=seconds(budget, "--budget"),
            listener=listener,
        )
    end_if_stopped(found.name, trained.stop_code)
    from karolos.comparison.suite import suite_report
    from karolos.report.suite import entries_table, grid_table, measures_table, notes, verdict, write_report

    label = " ".join(overrides or ()) or found.name
    report = suite_report(trained, label, others)
    for warning in report.warnings:
        warn(warning)
    name = "-".join([found.name, *re.findall(r"[\w.]+", label)] if overrides else [found.name])
    page = runs / FOLDER / name[:100] / "report.html"
    tables = [one for one in (grid_table(report), entries_table(report), measures_table(report)) if one.rows]
    if not (quiet or json):
        print(verdict(report))
    print_report(report.rows(), tables, notes(report), quiet=quiet, json=json)
    write_report(report, page)
    if not quiet:
        say(f"wrote {page}")
    raise typer.Exit(trained.exit_code)


def _folder(beside: str | None) -> Path | None:
    """The folder of the runs to compare with. Raises UsageError if it is missing."""
    from karolos.records.shipped import FOLDER as SHIPPED

    if beside is None:
        return None
    path = SHIPPED if beside == "shipped" else Path(beside)
    if not path.is_dir():
        raise UsageError(f"there is no folder {beside}", where="--beside", hint="name a folder of runs, or `shipped`")
    return path
