"""Output of commands: rows as JSON or a table on stdout, and lines for a person on stderr."""

from __future__ import annotations

import json as json_text
import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from karolos.errors import UsageError
from karolos.report.tables import Table, clean, finite

if TYPE_CHECKING:
    from pathlib import Path

    from rich.table import Table as RichTable

    from karolos.records.sweep_records import Trial

WIDEST = 10_000
"""A width that is enough for every table."""
_STATE_STYLES = {
    "finished": "green",
    "running": "cyan",
    "created": "cyan",
    "stopped": "yellow",
    "failed": "red",
    "lost": "red",
}


def say(text: str) -> None:
    """Print a line for a person on stderr."""
    print(clean(text), file=sys.stderr, flush=True)


def warn(text: str) -> None:
    """Print a warning on stderr."""
    say(f"warning: {text}")


def print_line(text: str) -> None:
    """Print one line on stdout."""
    print(clean(text), flush=True)


def print_rows(rows: Iterable[Mapping[str, Any]], *, json: bool, line: str = "") -> None:
    """Print one JSON object per row, or a table of the columns that are not empty in all rows.

    `line` prints each row as a line in this format instead of the table, e.g. "{run} -> {folder}".
    """
    if json or line:
        for row in rows:
            text = json_text.dumps(finite(row), allow_nan=False, default=str) if json else clean(line.format_map(row))
            print(text, flush=True)
        return
    listed = list(rows)
    if listed:
        names = [name for name in listed[0] if any(row.get(name) not in (None, "", []) for row in listed)]
        print_table(Table(names, [[short_text(row.get(name), 6) for name in names] for row in listed]))


def print_report(
    rows: Iterable[Mapping[str, Any]], tables: Iterable[Table], notes: Iterable[str], *, quiet: bool, json: bool
) -> None:
    """Print a report as JSON rows, or as tables with the meaning of their numbers."""
    if json:
        print_rows(rows, json=True)
    elif not quiet:
        for table in tables:
            print_table(table)
        for line in notes:
            print(f"  {line}")


def check_folder(path: Path, allowed: str) -> None:
    """Raise UsageError if the name of a folder for figures (--out) looks like a file, unless the folder exists."""
    if path.suffix and not path.is_dir():
        hint = f"name {allowed}; a folder with a dot in its name has to be there"
        raise UsageError(f"cannot write figures into {path.name!r}", where="--out", hint=hint)


def print_table(table: Table) -> None:
    """Print a table: on a terminal coloured and folded to its width, in a pipe one line per row with whole cells."""
    if sys.stdout.isatty():
        _print_in_terminal(table)
        return
    if table.title:
        print(f"\n{clean(table.title)}")
    lines = [table.columns] if any(table.columns) else []
    cells = [[clean(cell) for cell in line] for line in (*lines, *table.rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    for line in cells:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip())


def _print_in_terminal(table: Table) -> None:
    """Print a table. If it is too wide, headings are folded; if that is not enough, optional columns are left out."""
    from rich.console import Console

    console, left_out = Console(), []
    whole = console.options.update(width=WIDEST)
    drawn = rich_table(table)
    while console.measure(drawn, options=whole).maximum > console.width:
        folded = [name.replace("_", "_\n").replace(" ", "\n") for name in table.columns]
        drawn = rich_table(replace(table, columns=folded))
        if not table.optional or console.measure(drawn, options=whole).maximum <= console.width:
            break
        left_out.append(table.optional[0])
        table = table.without(table.optional[0])
    console.print(drawn)
    if left_out:
        say(f"left out, because the terminal is narrow: {', '.join(left_out)}")


def rich_table(table: Table) -> RichTable:
    """A table for a terminal. Texts are taken literally; columns of numbers are aligned at the right."""
    from rich import box
    from rich.table import Table as RichTable
    from rich.text import Text

    headed = any(table.columns)
    drawn = RichTable(
        box=box.SIMPLE_HEAD if headed else None,
        show_header=headed,
        title=Text(clean(table.title)) if table.title else None,
        title_justify="left",
        pad_edge=False,
        collapse_padding=True,
    )
    for place, name in enumerate(table.columns):
        numbers = all(row[place] in ("", "-") or row[place][0].isdigit() for row in table.rows)
        style = "bold" if not name and place == 0 else None  # names of the rows
        justify: Any = "right" if numbers else "left"
        drawn.add_column(
            Text(clean(name, allowed="\n")),
            overflow="fold",
            justify=justify,
            style=style,
            no_wrap=headed and place == 0,  # names can be copied
        )
    for row in table.rows:
        drawn.add_row(
            *(
                Text(clean(cell), _STATE_STYLES.get(cell, "") if name == "state" else "")
                for name, cell in zip(table.columns, row, strict=True)
            )
        )
    return drawn


def drawn_text(trial: Trial) -> str:
    """The settings of a trial in one line."""
    return ", ".join(f"{key}={short_text(value)}" for key, value in trial.drawn.items())


def short_text(value: object, digits: int = 4) -> str:
    """A value with few significant digits, or several separated by spaces; empty for None."""
    if isinstance(value, list | tuple):
        return " ".join(map(str, value))
    return f"{value:.{digits}g}" if isinstance(value, float) else "" if value is None else str(value)
