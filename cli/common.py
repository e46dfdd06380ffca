"""What commands share: options, and how rows and text reach the terminal."""

from __future__ import annotations

import csv
import json as json_text
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from karolos.report.terminal import clean

Runs = Annotated[Path, typer.Option("--runs", envvar="KAROLOS_RUNS", help="Folder of the run folders.", file_okay=True)]
Database = Annotated[
    str | None,
    typer.Option(
        "--database",
        envvar="KAROLOS_DATABASE",
        help="SQLAlchemy URL of the results database. Default: karolos.sqlite in the runs folder.",
        show_default=False,
    ),
]
RUN_HELP = "A run's id or how it begins, @last for the newest, @last-1 for the one before, or a run folder."
PIPE_WIDTH = 500
"""Columns of a table that goes into a pipe."""
Overrides = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[PATH=VALUE]...",
        help="Settings that replace the spec's, e.g. agent.learning_rate=1e-4 seeds=[0,1].",
        show_default=False,
    ),
]
Json = Annotated[bool, typer.Option("--json", help="One JSON object per row.")]


def rows(found: Iterable[Mapping[str, Any]], *, json: bool) -> None:
    """Print rows to stdout: one JSON object each, or columns under their names; without those where nothing stands."""
    listed = list(found)
    if json:
        for row in listed:
            print(json_text.dumps(_finite(row), allow_nan=False, default=str))
        return
    if listed:
        names = [name for name in listed[0] if any(row.get(name) not in (None, "", []) for row in listed)]
        table([[_text(row.get(name)) for name in names] for row in listed], names)


def csv_rows(found: Sequence[Mapping[str, Any]]) -> None:
    """Print rows as comma-separated values under their names; lists as one cell.

    A text that a spreadsheet would take for a formula gets an apostrophe in front (OWASP, CSV injection).
    """
    if not found:
        return
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(found[0])
    writer.writerows([_csv_cell(value) for value in row.values()] for row in found)


def _csv_cell(value: Any) -> object:
    if isinstance(value, list | tuple):
        value = "; ".join(map(str, value))
    if not isinstance(value, str):
        return value
    text = "".join(sign if sign.isprintable() or sign == "\n" else "\N{REPLACEMENT CHARACTER}" for sign in value)
    return f"'{text}" if text.startswith(("=", "+", "-", "@")) else text


def table(lines: Sequence[Sequence[str]], names: Sequence[str]) -> None:
    """Print cells in columns under their names; the last column is as wide as it needs."""
    cells = [list(names), *([clean(cell) for cell in line] for line in lines)]
    widths = [max(len(line[place]) for line in cells) for place in range(len(names))]
    for line in cells:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


def _finite(value: Any) -> Any:
    """The value with null for numbers that JSON does not have: nan and the infinities."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return value


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6g}"
    return " ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def print_rich(what: object) -> None:
    """To stdout, as wide as a terminal is; in a pipe a program or an editor reads, which should see whole cells."""
    from rich.console import Console

    if sys.stdout.isatty():
        Console().print(what)
        return
    console = Console(width=PIPE_WIDTH)
    with console.capture() as captured:
        console.print(what)
    print("\n".join(line.rstrip() for line in captured.get().splitlines()))
