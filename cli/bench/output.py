"""How the benchmarks print what they measured."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from karolos.benchmarks.side_by_side import Row

COLUMNS = ("benchmark", "case", "value", "unit", "peer", "peer_value", "ratio", "ratio_min", "ratio_max")


def print_rows(rows: Iterable[Row], *, as_json: bool) -> None:
    """Rows on stdout: a table, or one JSON object per line."""
    if as_json:
        for row in rows:
            typer.echo(json.dumps(row.dump()))
        return
    table = [row.dump() for row in rows]
    cells = [COLUMNS, *(tuple(_cell(line[column]) for column in COLUMNS) for line in table)]
    widths = [max(len(line[column]) for line in cells) for column in range(len(COLUMNS))]
    for line in cells:
        typer.echo("  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip())


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:,.0f}" if value >= 1000 else f"{value:.3g}"
    return str(value)
