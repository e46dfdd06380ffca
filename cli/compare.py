"""`karolos compare`: experiments side by side, with intervals that fit the number of seeds."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from karolos.errors import UsageError
from karolos.report.terminal import clean

from .common import Database, Json, Runs, print_rich, rows
from .selection import MANY_HELP, open_store, select

if TYPE_CHECKING:
    from collections.abc import Sequence

    from karolos.comparison import Comparison
    from karolos.records.run_records import RunSummary


def compare(
    experiments: Annotated[
        list[str],
        typer.Argument(
            metavar="EXPERIMENT...",
            help=f"{MANY_HELP} All runs of an experiment are its seeds. The first is what others are measured against.",
            show_default=False,
        ),
    ],
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
    success: Annotated[
        Literal["any", "end"],
        typer.Option(help="Success at any step of an episode or at its end: what curves and thresholds go by."),
    ] = "any",
    html: Annotated[
        Path | None, typer.Option(help="Write a page with every figure, which needs no network.", show_default=False)
    ] = None,
    figures: Annotated[
        Path | None, typer.Option(help="Folder to write the figures into, as SVG and PDF.", show_default=False)
    ] = None,
) -> None:
    """Compare experiments: success with its interval, steps and time to 50 and 90 %, cost, and what differs."""
    from karolos.comparison import compare as compared
    from karolos.comparison import gather

    _check_targets(html, figures)
    store = open_store(runs, database)
    if store is None:
        raise UsageError(f"there are no runs in {runs} yet", hint="`karolos run SPEC` makes one")
    with store:
        chosen = [select(store, selector) for selector in experiments]
        labels = _labels(experiments, chosen)
        contenders = [gather(store, found, label) for found, label in zip(chosen, labels, strict=True)]
    comparison = compared(contenders, success)
    _show(comparison, json=json)
    if html is not None:
        from karolos.report.page import write_page

        write_page(comparison, html)
        print(f"wrote {html}", file=sys.stderr)
    if figures is not None:
        from karolos.report.charts import charts
        from karolos.report.figures import write_figures

        written = write_figures(charts(comparison), figures)
        print(f"wrote {len(written)} figures into {figures}", file=sys.stderr)


def _check_targets(html: Path | None, figures: Path | None) -> None:
    """Refuse what cannot be written before anything is computed."""
    if html is not None and (html.is_dir() or not html.parent.is_dir()):
        wrong = "is a folder" if html.is_dir() else f"there is no folder {html.parent}"
        raise UsageError(f"{html} cannot be written: {wrong}", hint="name a file in a folder that is there")
    if figures is not None and figures.exists() and not figures.is_dir():
        raise UsageError(f"{figures} is a file", hint="--figures takes a folder")


def _labels(selectors: Sequence[str], chosen: Sequence[Sequence[RunSummary]]) -> list[str]:
    """What each is called: its experiment's name, with the hash where several are called so; a run then by its id.

    Raises:
        UsageError: two arguments mean the same runs.
    """
    met: dict[frozenset[str], str] = {}
    for selector, found in zip(selectors, chosen, strict=True):
        same = met.setdefault(frozenset(run.run for run in found), selector)
        if same is not selector:
            raise UsageError(f"{same!r} and {selector!r} mean the same runs", hint="name each once")
    names = Counter(found[0].name for found in chosen)
    return [found[0].name if names[found[0].name] == 1 else _distinct(found) for found in chosen]


def _distinct(found: Sequence[RunSummary]) -> str:
    """What tells it from another experiment or run of the same name."""
    return found[0].run if len(found) == 1 else f"{found[0].name} {found[0].experiment[:8]}"


def _show(comparison: Comparison, *, json: bool) -> None:
    """Rows to stdout; what to beware of to stderr."""
    for warning in comparison.warnings:
        print(f"warning: {clean(warning)}", file=sys.stderr)
    if json:
        rows(comparison.rows(), json=True)
        return
    from karolos.report.comparison_cells import explanations
    from karolos.report.comparison_tables import parameters_table, scores_table

    print_rich(scores_table(comparison))
    for line in explanations(comparison):
        print(f"  {line}")
    if len(comparison.contenders) > 1:
        print_rich(parameters_table(comparison) if comparison.parameters else "\nthe specs are the same")
