"""A comparison as one HTML file that needs nothing else: no network, no script, no font."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from pathlib import Path

from .. import __version__
from ..comparison import ComparedRun, Comparison
from ..files import write_whole
from ..statistics.intervals import wilson
from . import charts, svg
from .chart import LIGHT, Chart
from .comparison_cells import Row, explanations, parameter_rows, score_rows
from .markup import Markup, tag
from .style import style
from .tables import count, duration


def write_page(comparison: Comparison, path: Path) -> None:
    """Write the page, whole or not at all.

    Raises:
        MachineError: the file cannot be written.
    """
    write_whole(path, page(comparison))


def page(comparison: Comparison) -> str:
    """The page as text. Its security policy allows the style sheet inside it, named by its hash, and nothing else."""
    labels = [contender.label for contender in comparison.contenders]
    title = f"{' and '.join(labels) if len(labels) < 3 else f'{labels[0]} and {len(labels) - 1} others'} compared"
    rules = Markup(style(len(labels)))
    digest = base64.b64encode(hashlib.sha256(rules.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=policy),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="referrer", content="no-referrer"),
        tag("title", title),
        tag("style", rules),
    )
    body = tag("body", tag("h1", title), *_sections(comparison))
    return f"<!doctype html>\n{tag('html', head, body, lang='en')}\n"


def _sections(comparison: Comparison) -> list[Markup | None]:
    labels = [contender.label for contender in comparison.contenders]
    densities = list(charts.density_charts(comparison))
    parameters = parameter_rows(comparison)
    return [
        tag("p", f"{sum(len(one.runs) for one in comparison.contenders)} runs, karolos {__version__}."),
        _warnings(comparison.warnings),
        _keys(labels),
        tag("h2", "Learning"),
        _figures([charts.learning(comparison, "steps"), charts.learning(comparison, "seconds")]),
        tag("h2", "In numbers"),
        _table("", labels, score_rows(comparison)),
        tag("ul", *(tag("li", _kept(line)) for line in explanations(comparison)), class_="notes"),
        tag("h2", "Settings that differ") if len(labels) > 1 else None,
        _table("setting", labels, parameters) if parameters else None,
        tag("p", "The specs are the same.") if len(labels) > 1 and not parameters else None,
        tag("h2", "Seeds"),
        _figures([charts.final(comparison), charts.profiles(comparison)]),
        tag("h2", "Density of the success ratio over training"),
        tag(
            "p",
            "At each test the kernel density over the seeds, reflected at 0 and 1 and normalised by Simpson's rule. "
            "The darker, the denser (by the root of the density; one scale for all). Bold: its mean; thin: 5 and 95 % "
            "of its mass lie below."
            if densities
            else "A single seed has no density.",
        ),
        _figures(densities),
        tag("h2", "Runs"),
        _runs(comparison),
    ]


def _warnings(warnings: Sequence[str]) -> Markup | None:
    return tag("ul", *(tag("li", warning) for warning in warnings), class_="warnings") if warnings else None


def _keys(labels: Sequence[str]) -> Markup:
    """The legend; each entry shows or hides its contender, without a script."""
    line = tag("polyline", points="1,5 25,5", class_="main")
    entries = [
        tag(
            "label",
            tag("input", type="checkbox", checked=True, id=f"e{place}"),
            tag("svg", line, viewBox="0 0 26 10", class_=svg.series_classes(place).rsplit(" ", 1)[0]),
            label,
        )
        for place, label in enumerate(labels)
    ]
    seeds = tag("label", tag("input", type="checkbox", checked=True, id="seeds"), "each seed")
    return tag("div", *entries, seeds, class_="keys")


def _figures(drawn: Sequence[Chart]) -> Markup:
    return tag("div", *map(_figure, drawn), class_="figures")


def _figure(chart: Chart) -> Markup:
    series = {mark.series for mark in chart.marks}
    only = f"s{series.pop()}" if len(series) == 1 else None  # goes when its contender is hidden
    return tag("figure", tag("h3", chart.title), svg.draw(chart), tag("figcaption", _kept(chart.caption)), class_=only)


def _table(corner: str, labels: Sequence[str], rows: Sequence[Row]) -> Markup:
    names = [
        tag("th", tag("span", class_=f"swatch c{place % len(LIGHT)}"), label, scope="col")
        for place, label in enumerate(labels)
    ]
    lines = [
        tag("tr", tag("th", _kept(name), scope="row"), *(tag("td", cell) for cell in cells)) for name, cells in rows
    ]
    head = tag("thead", tag("tr", tag("th", corner), *names))
    return tag("div", tag("table", head, tag("tbody", *lines)), class_="scroll", tabindex=0)


def _kept(text: str) -> str:
    """Without a break between a number and its sign."""
    return text.replace(" %", "\N{NO-BREAK SPACE}%")


def _runs(comparison: Comparison) -> Markup:
    runs = [(series, run) for series, contender in enumerate(comparison.contenders) for run in contender.runs]
    labelled = any(run.summary.tags or run.summary.note for _, run in runs)
    names = ["run", "seed", "state", "steps", "time", "success any", "success end", "updates/s", "code"]
    names += ["tags", "note"] if labelled else []
    lines = [_run(series, run, labelled=labelled) for series, run in runs]
    head = tag("thead", tag("tr", *(tag("th", name, scope="col") for name in names)))
    return tag("div", tag("table", head, tag("tbody", *lines)), class_="scroll", tabindex=0)


def _run(series: int, run: ComparedRun, *, labelled: bool) -> Markup:
    summary, last = run.summary, run.tests[-1]
    successes = [
        f"{k / last.episodes:.2f} [{low:.2f}, {high:.2f}]"
        for k in (last.any, last.end)
        for low, high in [wilson(k, last.episodes)]
    ]
    numbers = [count(summary.steps), duration(summary.seconds), *successes, _rate(run), run.commit or "-"]
    state = summary.state if summary.error is None else f"{summary.state}: {summary.error}"
    labels = (", ".join(summary.tags), summary.note or "")
    return tag(
        "tr",
        tag("td", tag("span", class_=f"swatch c{series % len(LIGHT)}"), summary.run, class_="number"),
        tag("td", str(summary.seed)),
        tag("td", state, class_="long"),
        *(tag("td", number, class_="number") for number in numbers),
        *(tag("td", text, class_="long") for text in (labels if labelled else ())),
        class_=f"s{series}",
    )


def _rate(run: ComparedRun) -> str:
    return "-" if run.updates_per_second is None else f"{run.updates_per_second:,.0f}"
