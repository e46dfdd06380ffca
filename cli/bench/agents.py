"""karolos bench agents."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..common import Overrides
from .output import print_rows


def agents(
    overrides: Overrides = None,
    folder: Annotated[Path, typer.Option("--runs", help="Folder of the runs and of the table.")] = Path("runs/bench"),
    only: Annotated[str | None, typer.Option(help="Beginnings of entries, by comma: pendulum,panda_reach sac.")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="How many runs of each.")] = 5,
    quick: Annotated[bool, typer.Option("--quick", help="Toys that prove nothing but that they run.")] = False,
    peers: Annotated[bool, typer.Option("--peers", help="Beside stable-baselines3, tuned, for as many steps.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object per line.")] = False,
) -> None:
    """What each agent learns with each buffer, over several seeds. Takes hours; goes on where it was broken off.

    The table so far lies in the runs folder as agents.md and agents.json.
    """
    from karolos.benchmarks.agents import measure

    results = measure(
        folder,
        overrides=overrides or (),
        only=() if only is None else tuple(part.strip() for part in only.split(",")),
        seeds=seeds,
        peers=peers,
        quick=quick,
        say=lambda line: typer.echo(line, err=True),
    )
    print_rows((result.row() for result in results), as_json=as_json)
