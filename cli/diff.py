"""`karolos diff`: differences in what two runs were made from."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .arguments import Database, Json, Runs, open_run
from .completion import complete_run
from .output import print_rows, print_table, say

if TYPE_CHECKING:
    from karolos.comparison.differences import Side

_HELP = "A run's id or how it begins, @last, a run folder, or a spec file: what a run of it would be made from now."


def diff(
    a: Annotated[str, typer.Argument(metavar="A", help=_HELP, autocompletion=complete_run)],
    b: Annotated[str, typer.Argument(metavar="B", help="As A.", autocompletion=complete_run)],
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Show how two runs differ: settings, versions of karolos, plugins and libraries, git commit, changed files."""
    from karolos.comparison.differences import compare_sides

    one, other = _side(a, runs, database), _side(b, runs, database)
    found = list(compare_sides(one, other))
    if json:
        print_rows([difference.row() for difference in found], json=True)
    elif found:
        from karolos.report.comparison_tables import differences_table

        print_table(differences_table(found, one.name, other.name))
    else:
        say("no difference in settings, versions and code")


def _side(selector: str, runs: Path, database: str | None) -> Side:
    """What an argument means. Raises SpecError for a spec file that is missing."""
    from karolos.comparison.differences import of_run, of_spec
    from karolos.store.selectors import is_spec

    if is_spec(selector) or selector.endswith((".yaml", ".yml")):
        from karolos.specification import load_spec

        return of_spec(load_spec(Path(selector)), selector)
    return of_run(open_run(selector, runs, database))
