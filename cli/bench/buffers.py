"""`karolos bench buffers`."""

from __future__ import annotations

from typing import Annotated

import typer

from ..arguments import Json
from .output import print_measurements


def buffers(
    transitions: Annotated[int, typer.Option(min=1000, help="Transitions in each buffer.")] = 1_000_000,
    seconds: Annotated[float, typer.Option(min=0.1, help="Time for all measurements together.")] = 10.0,
    json: Json = False,
) -> None:
    """Measure the milliseconds to sample and to add, and the memory, of full replay buffers (pick-and-place)."""
    from karolos.benchmarks.buffers import measure

    print_measurements(measure(transitions=transitions, seconds=seconds), json=json)
