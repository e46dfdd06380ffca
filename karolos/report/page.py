"""Pages: self-contained HTML files made of sections; and the page of a comparison."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, FileSystemLoader
from markupsafe import Markup

from ..comparison import Comparison
from ..records import provenance
from ..records.run_records import RunRecord
from . import tables
from .figures import Drawing, style
from .tables import Columns, Table, count, duration, number, success

_INTERVAL = re.compile(r"(-?[\d.,]+|-) ((?:~?\[|\().*[\])])")
FOLDER = Path(__file__).parent
_DENSITIES = (
    "At each test the kernel density over the seeds, reflected at 0 and 1 and normalised by Simpson's rule. Darker is "
    "denser: shades follow the square root of the density and are the same in all figures. Bold: mean of the density; "
    "thin: 5 and 95 % of its mass are below."
)


@dataclass(frozen=True)
class Section:
    """A part of a page. It shows its non-empty fields, in this order."""

    heading: str = ""
    text: str = ""
    figures: Sequence[Drawing] = ()
    table: Table | None = None
    """Table. Its first column names the rows. On a page of contenders each other column belongs to one contender."""
    series: Sequence[int] = ()
    """Contender of each row, if the rows of the table belong to contenders."""
    links: Sequence[str] = ()
    """Addresses of the links on the names of the rows."""
    notes: Sequence[str] = ()


def document(
    title: str, what: str, sections: Iterable[Section], warnings: Sequence[str] = (), contenders: Sequence[str] = ()
) -> str:
    """An HTML file. Every text in it is escaped, and cleaned of characters that control a terminal or reorder a line.

    Its security policy allows only inline styles and pictures, which matplotlib's figures need. `what` it contains
    stands below the title, `warnings` above the sections. `contenders` are labels of check boxes that show or hide a
    contender, by the style sheet without scripts.
    """
    template = templates(FOLDER).get_template("page.html")
    return template.render(title=title, what=what, sections=sections, warnings=warnings, contenders=contenders)


def templates(*folders: Path) -> Environment:
    """The templates in these folders. Every value in them is escaped and cleaned."""
    loader = FileSystemLoader(folders)
    environment = Environment(loader=loader, autoescape=True, finalize=_cleaned, trim_blocks=True, lstrip_blocks=True)
    version = provenance.versions()["karolos"]
    environment.globals |= {"style": style, "version": version, "split": _split, "breakable": _breakable}
    return environment


def _split(text: str) -> tuple[str, str]:
    """A number and its interval, which is empty for any other text."""
    found = _INTERVAL.fullmatch(text)
    return (found[1], found[2]) if found else (text, "")


def _breakable(text: str) -> Markup:
    """A name with a possible line break after each underscore."""
    return Markup("_<wbr>").join(str(_cleaned(part)) for part in text.split("_"))


def _cleaned(value: object) -> object:
    return value if isinstance(value, Markup) else tables.clean(value, allowed="\n\N{NO-BREAK SPACE}")


def comparison_page(comparison: Comparison, drawings: Mapping[str, Sequence[Drawing]]) -> str:
    """A comparison as a page, with its figures by kind."""
    labels = comparison.labels
    title = f"{' and '.join(labels) if len(labels) < 3 else f'{labels[0]} and {len(labels) - 1} others'} compared"
    what = f"{sum(len(one.runs) for one in comparison.contenders)} runs"
    return document(title, what, comparison_sections(comparison, drawings), comparison.warnings, labels)


def comparison_sections(comparison: Comparison, drawings: Mapping[str, Sequence[Drawing]]) -> list[Section]:
    """The parts of a comparison's page, with the figures of each available kind."""
    labels, same = comparison.labels, not comparison.parameters
    settings = Section(
        "Settings that differ",
        "The specs are the same." if same else "",
        table=None if same else tables.parameters_table(comparison),
    )
    of = defaultdict[str, Sequence[Drawing]](tuple, drawings)
    measures = tables.compared_measures_table(comparison)
    return [
        Section(text=tables.verdict(comparison)),
        *_drawn("Learning", [*of["steps"], *of["time"]]),
        Section("In numbers", table=tables.scores_table(comparison), notes=tables.explanations(comparison)),
        *([Section("Measures", table=measures)] if measures.rows else []),
        *_drawn("", of["measures"]),
        *_drawn("Under other settings", of["settings"]),
        *([settings] if len(labels) > 1 else []),
        *_drawn("Seeds", [*of["final"], *of["profiles"]]),
        *_drawn("Density of the success ratio over training", of["densities"], _DENSITIES),
        _runs_section(comparison),
    ]


def _drawn(heading: str, figures: Sequence[Drawing], text: str = "") -> list[Section]:
    return [Section(heading, text, figures)] if figures else []


def _runs_section(comparison: Comparison) -> Section:
    columns: Columns[RunRecord] = {
        "run": lambda run: run.summary.run,
        "seed": lambda run: str(run.summary.seed),
        "state": lambda run: ": ".join(filter(None, (run.summary.state, run.summary.error))),
        "steps": lambda run: count(run.summary.steps),
        "time": lambda run: duration(run.summary.seconds),
        "success end": lambda run: success(run.reported("end") if run.has_success else None, run.episodes),
        "success any": lambda run: success(run.reported("any") if run.has_success else None, run.episodes),
        "best, end": lambda run: success(run.summary.best_end, run.episodes),
        "return": lambda run: number(run.reported("return")),
        "best, return": lambda run: number(run.summary.best_return),
        "updates/s": lambda run: count(run.updates_per_second),
        "code": lambda run: run.commit or "-",
        "tags": lambda run: ", ".join(run.summary.tags),
        "note": lambda run: run.summary.note or "",
    }
    runs = [run for contender in comparison.contenders for run in contender.runs]
    series = [place for place, contender in enumerate(comparison.contenders) for _ in contender.runs]
    return Section("Runs", table=Table.of(runs, columns), series=series)
