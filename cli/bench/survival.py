"""karolos bench survival."""

from __future__ import annotations

from typing import Annotated

import typer

from .output import print_rows


def survival(
    steps: Annotated[int, typer.Option(min=1000, help="Environment steps of the runs that are killed.")] = 50_000,
    seconds: Annotated[float, typer.Option(min=0.1, help="Between two killed workers.")] = 2.0,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object per line.")] = False,
) -> None:
    """What runs survive: a kill half-way, bit for bit; workers killed again and again. Takes minutes."""
    from karolos.benchmarks.survival import measure

    print_rows(measure(steps=steps, seconds=seconds, say=lambda line: typer.echo(line, err=True)), as_json=as_json)
