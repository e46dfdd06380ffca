"""`karolos bench store`."""

from __future__ import annotations

from typing import Annotated

import typer

from ..arguments import Json
from .output import print_measurements


def store(
    runs: Annotated[int, typer.Option(min=16, help="Runs in the database.")] = 10_000,
    tests: Annotated[int, typer.Option(min=1, help="Tests per run.")] = 50,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes per test.")] = 100,
    writers: Annotated[int, typer.Option(min=1, help="Processes that write at the same time.")] = 16,
    database: Annotated[
        str | None,
        typer.Option(help="URL of an empty database to fill and measure. Default: a SQLite file.", show_default=False),
    ] = None,
    json: Json = False,
) -> None:
    """Measure the seconds to rebuild, check and query the results database, and how fast many processes write to it."""
    from karolos.benchmarks.store import measure

    print_measurements(
        measure(runs=runs, tests=tests, episodes=episodes, writers=writers, database=database), json=json
    )
