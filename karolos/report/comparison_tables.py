"""A comparison for the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.table import Table
from rich.text import Text

from ..comparison import Comparison
from ..comparison.sides import Difference
from .comparison_cells import Row, cell, parameter_rows, score_rows
from .terminal import clean


def scores_table(comparison: Comparison) -> Table:
    """One row per number, one column per contender."""
    return _table([contender.label for contender in comparison.contenders], score_rows(comparison), "")


def parameters_table(comparison: Comparison) -> Table:
    """The settings that differ."""
    labels = [contender.label for contender in comparison.contenders]
    return _table(labels, parameter_rows(comparison), "settings that differ")


def differences_table(found: Sequence[Difference], a: str, b: str) -> Table:
    """What two runs were made from, where it differs."""
    rows = [(f"{one.part}: {one.key}", (cell(one.a), cell(one.b))) for one in found]
    return _table([a, b], rows, "")


def _table(labels: Sequence[str], rows: Sequence[Row], corner: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(corner, overflow="fold")
    for label in labels:
        table.add_column(Text(clean(label)), overflow="fold")
    for name, cells in rows:
        table.add_row(Text(clean(name), "bold"), *(Text(clean(cell)) for cell in cells))
    return table
