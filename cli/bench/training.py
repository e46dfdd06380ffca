"""karolos bench training."""

from __future__ import annotations

from typing import Annotated

import typer

from .output import print_rows


def training(
    seeds: Annotated[int, typer.Option(min=1, help="Runs from start to success; as many of the peer's.")] = 1,
    quick: Annotated[
        bool, typer.Option("--quick", help="Seconds, not minutes, and no run to success; the figures mean little.")
    ] = False,
    peers: Annotated[
        bool, typer.Option("--peers", help="Beside stable-baselines3 on panda-gym, where installed.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object per line.")] = False,
) -> None:
    """What learning while the environments step saves, and seconds until a Panda reaches, from start to success."""
    from karolos.benchmarks.training import QUICK, Amounts, measure

    amounts = QUICK if quick else Amounts(seeds=tuple(range(seeds)))
    rows = measure(amounts, peers=peers, end_to_end=not quick, say=lambda line: typer.echo(line, err=True))
    print_rows(rows, as_json=as_json)
