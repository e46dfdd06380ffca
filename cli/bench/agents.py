"""`karolos bench agents`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..arguments import Json, Overrides
from ..output import say
from .output import print_measurements


def agents(
    overrides: Overrides = None,
    folder: Annotated[Path, typer.Option("--runs", help="Folder of the runs and of the table.")] = Path("runs/bench"),
    only: Annotated[str | None, typer.Option(help="Beginnings of entries to run: pendulum,panda_reach sac.")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Runs of each entry.")] = 5,
    quick: Annotated[bool, typer.Option("--quick", help="Toy tasks, which only show that everything runs.")] = False,
    peers: Annotated[bool, typer.Option("--peers", help="Run tuned stable-baselines3 too.")] = False,
    json: Json = False,
) -> None:
    """Measure what each agent learns with each buffer over several seeds. Takes hours; a second call resumes.

    The table so far is in the runs folder as agents.md and agents.json.
    """
    from karolos.benchmarks.agents import measure

    results = measure(
        folder,
        overrides=overrides or (),
        only=() if only is None else tuple(part.strip() for part in only.split(",")),
        seeds=seeds,
        peers=peers,
        quick=quick,
        say=say,
    )
    print_measurements((result.row() for result in results), json=json)
