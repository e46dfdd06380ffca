"""karolos bench store."""

from __future__ import annotations

from typing import Annotated

import typer

from .output import print_rows


def store(
    runs: Annotated[int, typer.Option(min=16, help="Runs in the database.")] = 10_000,
    tests: Annotated[int, typer.Option(min=1, help="Tests of each run.")] = 50,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each test.")] = 100,
    writers: Annotated[int, typer.Option(min=1, help="Processes that write at once.")] = 16,
    database: Annotated[
        str | None,
        typer.Option(
            help="URL of an empty database to fill and measure; a SQLite file by default.", show_default=False
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object per line.")] = False,
) -> None:
    """Seconds to rebuild, check and ask the results database, and what many processes write into it at once."""
    from karolos.benchmarks.store import measure

    print_rows(measure(runs=runs, tests=tests, episodes=episodes, writers=writers, database=database), as_json=as_json)
