"""`karolos bench training`."""

from __future__ import annotations

from typing import Annotated

import typer

from ..arguments import Json
from ..output import say
from .output import print_measurements


def training(
    seeds: Annotated[int, typer.Option(min=1, help="Runs from start to success, and the same number of the peer.")] = 1,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Seconds, not minutes, and no run to success; the numbers mean little."),
    ] = False,
    peers: Annotated[
        bool, typer.Option("--peers", help="Measure stable-baselines3 on panda-gym too, if installed.")
    ] = False,
    json: Json = False,
) -> None:
    """Measure what learning while environments step saves, and the seconds until a Panda has learned to reach."""
    from karolos.benchmarks.training import QUICK, Amounts, measure

    amounts = QUICK if quick else Amounts(seeds=tuple(range(seeds)))
    rows = measure(amounts, peers=peers, end_to_end=not quick, say=say)
    print_measurements(rows, json=json)
