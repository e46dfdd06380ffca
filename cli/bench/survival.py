"""`karolos bench survival`."""

from __future__ import annotations

from typing import Annotated

import typer

from ..arguments import Json
from ..output import say
from .output import print_measurements


def survival(
    steps: Annotated[int, typer.Option(min=1000, help="Environment steps of each run that is killed.")] = 50_000,
    seconds: Annotated[float, typer.Option(min=0.1, help="Time between two killed workers.")] = 2.0,
    json: Json = False,
) -> None:
    """Kill a run half-way and compare the resumed one bit for bit; kill workers again and again. Takes minutes."""
    from karolos.benchmarks.survival import measure

    print_measurements(measure(steps=steps, seconds=seconds, say=say), json=json)
