"""karolos bench buffers."""

from __future__ import annotations

from typing import Annotated

import typer

from .output import print_rows


def buffers(
    transitions: Annotated[int, typer.Option(min=1000, help="How many the buffers hold.")] = 1_000_000,
    seconds: Annotated[float, typer.Option(min=0.1, help="Time for the measurements together.")] = 10.0,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object per line.")] = False,
) -> None:
    """Milliseconds to sample and to add, and memory, of replay buffers full of pick-and-place transitions."""
    from karolos.benchmarks.buffers import measure

    print_rows(measure(transitions=transitions, seconds=seconds), as_json=as_json)
