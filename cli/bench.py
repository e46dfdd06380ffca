"""karolos bench: how fast the parts are on this machine, beside a peer measured in the same run."""

from __future__ import annotations

import json
from collections.abc import Iterable
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from karolos.benchmarks.row import Row

app = typer.Typer(help="Measure the speed of parts, beside a peer in the same run.", no_args_is_help=True)
COLUMNS = ("benchmark", "case", "value", "unit", "peer", "peer_value", "ratio")


class Control(StrEnum):
    """How an action moves an arm."""

    JOINT = "joint"
    CARTESIAN = "cartesian"


@app.callback()
def bench() -> None:
    """Measure the speed of parts, beside a peer in the same run."""


@app.command()
def environment(
    robot: Annotated[str, typer.Option(help="Name of a robot.")] = "panda",
    task: Annotated[str, typer.Option(help="Name of a task.")] = "reach",
    control: Annotated[Control | None, typer.Option(help="One control mode only; both by default.")] = None,
    seconds: Annotated[float, typer.Option(min=0.1, help="Time for the measurements together.")] = 10.0,
    peers: Annotated[bool, typer.Option("--peers", help="Beside panda-gym, where it is installed.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object per line.")] = False,
) -> None:
    """Steps per second of a robot with a task on one core, beside the bare physics of the same episodes."""
    if peers:
        from karolos.benchmarks.peers import measure as measure_peers

        print_rows(measure_peers(seconds=seconds), as_json=as_json)
        return
    from karolos.benchmarks.environment import measure

    controls = [mode.value for mode in Control] if control is None else [control.value]
    print_rows(measure(robot, task, controls=controls, seconds=seconds), as_json=as_json)


def print_rows(rows: Iterable[Row], *, as_json: bool) -> None:
    """Rows on stdout: a table, or one JSON object per line."""
    table = [row.dump() for row in rows]
    if as_json:
        for line in table:
            typer.echo(json.dumps(line))
        return
    cells = [COLUMNS, *(tuple(_cell(line[column]) for column in COLUMNS) for line in table)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(COLUMNS))]
    for row in cells:
        typer.echo("  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip())


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:,.0f}" if value >= 1000 else f"{value:.3g}"
    return str(value)
