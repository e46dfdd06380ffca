"""karolos bench orchestrator."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .output import print_rows


def orchestrator(
    robot: Annotated[str, typer.Option(help="Name of a robot.")] = "panda",
    task: Annotated[str, typer.Option(help="Name of a task.")] = "reach",
    figure: Annotated[
        Path | None, typer.Option(help="Write the box plots: FILE.svg, .png or .pdf.", show_default=False)
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Seconds, not minutes; the figures mean little.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object per line.")] = False,
) -> None:
    """Resets and steps over processes and threads, beside gymnasium's vector environments; what to use here."""
    from karolos.benchmarks.orchestrator import QUICK, Amounts, measure
    from karolos.report.boxes import check_format, draw_boxes

    if figure is not None:
        check_format(figure)
    report = measure(robot, task, QUICK if quick else Amounts())
    print_rows(report.rows, as_json=as_json)
    for line in report.advice:
        typer.echo(line, err=True)
    if figure is not None:
        draw_boxes(report.panels, figure)
        typer.echo(f"wrote the box plots into {figure}", err=True)
