"""`karolos bench orchestrator`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..arguments import Json
from ..output import say
from .output import print_measurements


def orchestrator(
    robot: Annotated[str, typer.Option(help="Name of a robot.")] = "panda",
    task: Annotated[str, typer.Option(help="Name of a task.")] = "reach",
    figure: Annotated[
        Path | None, typer.Option(help="Box plots to write: FILE.svg, .pdf or .png.", show_default=False)
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Seconds, not minutes; the numbers mean little.")] = False,
    json: Json = False,
) -> None:
    """Measure resets and steps over processes and threads beside gymnasium's vector environments; advise settings."""
    from karolos.benchmarks.orchestrator import QUICK, Amounts, measure
    from karolos.report.figures import check_format, write_box_plots

    if figure is not None:
        check_format(figure)
    report = measure(robot, task, QUICK if quick else Amounts())
    print_measurements(report.rows, json=json)
    for line in report.advice:
        say(line)
    if figure is not None:
        write_box_plots(report.plots, figure)
        say(f"wrote the box plots into {figure}")
