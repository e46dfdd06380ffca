"""`karolos transfer`: policies between robots, engines and other settings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .arguments import Database, Jobs, Json, On, Overrides, Quiet, Runs, SpecFile, TimeLimit, seconds, with_launcher
from .output import check_folder, end_if_stopped, print_report, say, warn


def transfer(
    spec: SpecFile,
    overrides: Overrides = None,
    runs: Runs = Path("runs"),
    database: Database = None,
    jobs: Jobs = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue a matrix that has begun; nothing is run twice.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Also write every figure as SVG, PDF and PNG into this folder."),
    ] = None,
    on: On = None,
    time_limit: TimeLimit = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Train on every variant of SPEC's transfer, test the policies on the others, and fine-tune them there.

    Prints a matrix of sources and targets for each metric, and writes a page with heat maps and learning curves,
    transfers/NAME/report.html in the runs folder. The runs are ordinary runs: NAME-SOURCE, NAME-SOURCE-to-TARGET.
    """
    from karolos.specification import load_spec

    if out is not None:
        check_folder(out, "a folder")
    found = load_spec(spec, with_launcher(overrides, on))
    from karolos.transfer.matrix import Matrix

    from . import display

    with display.Quiet() if quiet else display.Plain() as listener:
        outcome = Matrix(found).run(
            runs,
            database=database,
            jobs=jobs,
            resume=resume,
            time_limit=seconds(time_limit),
            listener=listener,
            say=(lambda _: None) if quiet else say,
        )
    end_if_stopped(found.name, outcome.stop_code)
    from karolos.transfer.page import matrix_table, notes, variants_table, write_report
    from karolos.transfer.results import transfer_report

    report = transfer_report(outcome)
    for warning in report.warnings:
        warn(warning)
    tables = [*(matrix_table(report, name) for name in report.metrics), variants_table(report)]
    print_report(report.rows(), tables, notes(report), quiet=quiet, json=json)
    page = outcome.folder / "report.html"
    write_report(report, page, out)
    if not quiet:
        say(f"wrote {page}")
    raise typer.Exit(outcome.exit_code)
