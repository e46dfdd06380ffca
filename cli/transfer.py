"""`karolos transfer`: policies between robots, engines and other settings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .arguments import Database, Jobs, Json, On, Overrides, Quiet, Runs, SpecFile, TimeLimit, seconds, with_launcher
from .output import print_rows, print_table, say, warn

if TYPE_CHECKING:
    from karolos.transfer.results import TransferReport


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
    if outcome.stop_code:
        say(f"{found.name} is stopped: the same command with --resume continues it")
        raise typer.Exit(outcome.exit_code)
    from karolos.transfer.page import write_report
    from karolos.transfer.results import transfer_report

    report = transfer_report(outcome)
    for warning in report.warnings:
        warn(warning)
    if json:
        print_rows(report.rows(), json=True)
    elif not quiet:
        _print_report(report)
    page = outcome.folder / "report.html"
    write_report(report, page, out)
    if not quiet:
        say(f"wrote {page}")
    raise typer.Exit(outcome.exit_code)


def _print_report(report: TransferReport) -> None:
    from karolos.transfer.page import matrix_table, notes, variants_table

    for name in report.metrics:
        print_table(matrix_table(report, name))
    print_table(variants_table(report))
    for line in notes(report):
        print(f"  {line}")
