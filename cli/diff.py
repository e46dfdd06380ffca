"""`karolos diff`: how what two runs were made from differs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from karolos.report.terminal import clean

from .common import Database, Json, Runs, print_rich, rows
from .selection import is_spec, open_run

if TYPE_CHECKING:
    from karolos.comparison.sides import Side

_HELP = "A run's id or how it begins, @last, a run folder, or a spec file: what it would be run from now."


def diff(
    a: Annotated[str, typer.Argument(metavar="A", help=_HELP, show_default=False)],
    b: Annotated[str, typer.Argument(metavar="B", help="The same.", show_default=False)],
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
    patch: Annotated[
        bool, typer.Option("--patch", help="Print how their code.diff differ, line by line, instead.")
    ] = False,
) -> None:
    """Show where two runs differ: settings, versions of karolos, plugins and libraries, git commit, changed files."""
    from karolos.comparison.sides import compare_sides, patch_difference

    one, other = _side(a, runs, database), _side(b, runs, database)
    if patch:
        for line in patch_difference(one, other).splitlines():
            print(clean(line))
        return
    found = list(compare_sides(one, other))
    if json:
        rows([difference.row() for difference in found], json=True)
    elif found:
        from karolos.report.comparison_tables import differences_table

        print_rich(differences_table(found, one.name, other.name))
    else:
        print("no difference in settings, versions and code", file=sys.stderr)


def _side(selector: str, runs: Path, database: str | None) -> Side:
    """What an argument means."""
    from karolos.comparison import sides

    if is_spec(selector):
        from karolos.spec import load_spec

        return sides.of_spec(load_spec(Path(selector)), selector)
    return sides.of_run(open_run(selector, runs, database))
