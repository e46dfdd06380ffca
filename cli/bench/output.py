"""How the benchmarks print what they measured."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from karolos.report.tables import Table

from ..output import print_rows, print_table

if TYPE_CHECKING:
    from karolos.benchmarks.side_by_side import Row

COLUMNS = ("benchmark", "case", "value", "unit", "peer", "peer_value", "ratio", "ratio_min", "ratio_max")


def print_measurements(rows: Iterable[Row], *, json: bool) -> None:
    """Print a table, or one JSON object per measurement as soon as it is made."""
    measured = (row.dump() for row in rows)
    if json:
        print_rows(measured, json=True)
    else:
        print_table(Table(COLUMNS, [[_cell(row[column]) for column in COLUMNS] for row in measured]))


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:,.0f}" if value >= 1000 else f"{value:.3g}"
    return str(value)
