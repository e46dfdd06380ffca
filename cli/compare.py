"""`karolos compare` and `karolos diff`: compare experiments, and the sources of two runs."""

from __future__ import annotations

from contextlib import nullcontext, suppress
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from karolos.errors import NoSuchRunError, UsageError
from karolos.report.tables import counted

from .arguments import MANY_HELP, Database, Json, Runs, check_file, open_run, open_store
from .completion import complete_policy, complete_run
from .output import check_folder, print_rows, print_table, say, warn

if TYPE_CHECKING:
    from collections.abc import Sequence

    from karolos.comparison import Comparison
    from karolos.comparison.differences import Side
    from karolos.records.run_records import RunSummary
    from karolos.store import Store


SIDE_HELP = (
    "A run (its id, the beginning of its id, its folder or @last), or a spec file (a run that it would make now)."
)


def compare(
    experiments: Annotated[
        list[str],
        typer.Argument(
            metavar="EXPERIMENT...",
            help=f"{MANY_HELP} Or a shipped policy. The first one is the baseline of the others.",
            autocompletion=complete_policy,
        ),
    ],
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
    metric: Annotated[
        Literal["any", "end", "return"] | None,
        typer.Option(
            help="What curves and thresholds show: success at any step of an episode, success at its end, or return. "
            "Default: end; return if the environment defines no success."
        ),
    ] = None,
    at: Annotated[
        int | None,
        typer.Option(
            metavar="STEPS",
            min=1,
            help="Compare the tests nearest to this number of environment steps, e.g. if some runs are longer. "
            "Default: the ends of the runs.",
        ),
    ] = None,
    label: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Name in tables and figures. Give one for each experiment, in order."),
    ] = None,
    out: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE.html|FOLDER",
            help="Write FILE.html, one page with every figure that works offline, or a folder with the figures as "
            "SVG, PDF and PNG. May be repeated.",
        ),
    ] = None,
    table: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE.tex|FILE.csv",
            help="Write the numbers as a LaTeX table (package booktabs) or as CSV, one row per experiment. "
            "May be repeated.",
        ),
    ] = None,
    figure: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Draw only this figure: steps, time, final, profiles, densities, measures, settings, or a file name "
            "such as measure_peak_force. May be repeated.",
        ),
    ] = None,
    width: Annotated[float, typer.Option(min=1, max=40, help="Width of a figure in the folder, in inches.")] = 4.8,
    font: Annotated[float, typer.Option(min=2, max=60, help="Size of the text in these figures, in points.")] = 9,
) -> None:
    """Compare experiments: success and return with intervals, steps and time to 50 and 90 %, cost, settings."""
    from karolos.comparison import compare as compare_contenders
    from karolos.comparison import gather

    pages = [path for path in out or () if path.suffix == ".html"]
    folders = [path for path in out or () if path.suffix != ".html"]
    for folder in folders:
        check_folder(folder, "a file that ends in .html, or a folder")
    for path in table or ():
        if path.suffix not in (".tex", ".csv"):
            hint = "name a file that ends in .tex or .csv"
            raise UsageError(f"cannot write a table into {path.name!r}", where="--table", hint=hint)
    if figure and not out:
        raise UsageError("nothing is drawn", where="--figure", hint="name a page or a folder with --out")
    for file in (*pages, *(table or ())):
        check_file(file)
    with open_store(runs, database) or nullcontext() as store:
        selected = [_runs_of(selector, store, runs) for selector in experiments]
        labels = _labels(label, experiments, [found for _, found in selected])
        contenders = [gather(*found, *names) for found, *names in zip(selected, labels, experiments, strict=True)]
        comparison = compare_contenders(contenders, metric, store, at=at)
    for warning in comparison.warnings:
        warn(warning)
    if json:
        print_rows(comparison.rows(), json=True)
    else:
        _print_comparison(comparison)
    from karolos.report.tables import comparison_file
    from karolos.system.files import write_whole

    for path in table or ():
        write_whole(path, comparison_file(comparison, path.suffix))
        say(f"wrote {path}")
    if not out:
        return
    from karolos.report.comparison_figures import comparison_figures
    from karolos.report.figures import write_figures
    from karolos.report.page import comparison_page

    drawings = comparison_figures(comparison, figure or ())
    for path in pages:
        write_whole(path, comparison_page(comparison, drawings))
        say(f"wrote {path}")
    for folder in folders:
        files = write_figures([*chain(*drawings.values())], folder, width=width, font=font)
        say(f"wrote {counted(len(files), 'file')} into {folder}")


def _runs_of(selector: str, store: Store | None, runs: Path) -> tuple[Store | None, tuple[RunSummary, ...]]:
    """The runs that a selector means and their index; None for a shipped run, or a run that is not indexed."""
    from karolos.records import RunFolder
    from karolos.records.shipped import SHIPPED
    from karolos.store.query import existing, is_run_folder, select, shipped_run

    if shipped := shipped_run(selector, store):
        if not selector.startswith(SHIPPED):
            say(f"{selector}: the shipped policy, because the index of {runs} has no run of this name")
        return None, (shipped.summary(),)
    if is_run_folder(selector):
        with suppress(NoSuchRunError):
            return store, select(existing(store, selector, runs), selector)
        return None, (RunFolder.open(selector).summary(),)
    store = existing(store, selector, runs)
    return store, select(store, selector, or_trial=True)


def _labels(
    chosen: Sequence[str] | None, selectors: Sequence[str], selected: Sequence[Sequence[RunSummary]]
) -> Sequence[str]:
    """The label of each experiment: as chosen, or that of `labels_of`.

    Raises UsageError if labels are missing or not distinct, or two arguments mean the same run.
    """
    from karolos.comparison.contenders import labels_of

    if chosen and (len(chosen) != len(selectors) or len(set(chosen)) < len(chosen)):
        raise UsageError(
            f"{len(set(chosen))} different labels for {len(selectors)} experiments",
            where="--label",
            hint="give --label once for each experiment, in their order",
        )
    first: dict[str, str] = {}
    for selector, found in zip(selectors, selected, strict=True):
        for run in found:
            if run.run in first:
                raise UsageError(f"{first[run.run]!r} and {selector!r} both mean {run.run}", hint="name each run once")
        first |= {run.run: selector for run in found}
    return chosen or labels_of(selected)


def _print_comparison(comparison: Comparison) -> None:
    from karolos.report.tables import (
        compared_measures_table,
        explanations,
        parameters_table,
        scores_table,
        verdict,
    )

    print(f"{verdict(comparison)}\n")
    print_table(scores_table(comparison))
    if comparison.measures:
        print_table(compared_measures_table(comparison))
    print()
    for line in explanations(comparison):
        print(f"  {line}")
    if comparison.parameters:
        print_table(parameters_table(comparison))
    elif len(comparison.contenders) > 1:
        print("\nthe specs are the same")


def diff(
    a: Annotated[str, typer.Argument(metavar="A", help=SIDE_HELP, autocompletion=complete_run)],
    b: Annotated[str, typer.Argument(metavar="B", help="Another run or spec file.", autocompletion=complete_run)],
    runs: Runs = Path("runs"),
    database: Database = None,
    json: Json = False,
) -> None:
    """Show how two runs differ: settings, versions of karolos, plugins and libraries, git commit, changed files."""
    from karolos.comparison.differences import compare_sides

    one, other = _side(a, runs, database), _side(b, runs, database)
    found = list(compare_sides(one, other))
    if json:
        print_rows(found, json=True)
    elif found:
        from karolos.report.tables import differences_table

        print_table(differences_table(found, one.name, other.name))
    else:
        say("no difference in settings, versions and code")


def _side(selector: str, runs: Path, database: str | None) -> Side:
    """The side that an argument means. Raises SpecError if a spec file is missing."""
    from karolos.comparison.differences import of_run, of_spec
    from karolos.store.query import is_spec

    if is_spec(selector) or selector.endswith((".yaml", ".yml")):
        from karolos.specification import load_spec

        spec = load_spec(Path(selector))
        return of_spec(spec.alone().dump(), spec.files(), selector)
    return of_run(open_run(selector, runs, database))
