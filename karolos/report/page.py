"""A comparison as one HTML file that needs nothing else: no network, no script, no font."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from .. import __version__
from ..comparison import ComparedRun, Comparison
from ..files import write_whole
from .comparison_tables import explanations, parameters_table, scores_table
from .figures import COLOURS, DASHES, Drawing
from .markup import Markup, tag
from .tables import Columns, Table, count, duration, number, success

_STYLE = """
:root{color-scheme:light;--soft:#5c5c5c;--panel:#f6f6f4;--rule:#d9d9d4}
*{box-sizing:border-box}
body,svg text{font-family:system-ui,-apple-system,"Segoe UI",Roboto,"Liberation Sans",sans-serif!important}
body{margin:0 auto;padding:1rem;max-width:78rem;background:#fff;color:#1c1c1c;font-size:16px;line-height:1.5}
h1{font-size:1.5rem;line-height:1.25;margin:.5rem 0;overflow-wrap:anywhere}
h2{font-size:1.2rem;margin:2.2rem 0 .6rem}
p,figcaption,.notes{color:var(--soft);margin:.3rem 0;max-width:65rem}
figcaption,.notes{font-size:.85rem}
.notes{padding-left:1.1rem}
.warnings{background:#fff3d6;border-radius:6px;padding:.6rem 1rem .6rem 2rem;margin:1rem 0;overflow-wrap:anywhere}
.legend{display:flex;flex-wrap:wrap;gap:.3rem 1.2rem;margin:1rem 0;padding:.5rem 0;position:sticky;top:0;z-index:1;
background:#fff;border-bottom:1px solid var(--rule)}
.legend label{display:inline-flex;gap:.4rem;align-items:center;cursor:pointer;overflow-wrap:anywhere}
.swatch{width:26px;height:10px;flex:none;margin-right:.3rem}
.figures{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,30rem),1fr));gap:1.2rem}
figure{margin:0;padding:.8rem;background:var(--panel);border-radius:8px;min-width:0}
figure svg{display:block;width:100%;height:auto;max-width:40rem;border-radius:4px}
.scroll{overflow-x:auto}
table{border-collapse:collapse;font-size:.9rem;font-variant-numeric:tabular-nums}
th,td{padding:.3rem .7rem;text-align:left;vertical-align:top;border-bottom:1px solid var(--rule);
overflow-wrap:break-word;max-width:24rem}
thead th{border-bottom:2px solid var(--rule)}
tbody th,thead th:first-child{position:sticky;left:0;background:#fff;font-weight:normal}
tbody th{color:var(--soft)}
td{white-space:nowrap}
td:first-child{max-width:none}
td.long{white-space:pre-line;min-width:6rem}
@media (max-width:40rem){.legend{position:static}body{padding:.7rem}figure{padding:.4rem}tbody th{max-width:8rem}}
@media print{.legend{position:static}figure{break-inside:avoid}}
body:has(#seeds:not(:checked)) .seed{display:none}
"""


def write_page(comparison: Comparison, drawings: Sequence[Drawing], path: Path) -> None:
    """Write the page, whole or not at all.

    Raises:
        MachineError: the file cannot be written.
    """
    write_whole(path, page(comparison, drawings))


def page(comparison: Comparison, drawings: Sequence[Drawing]) -> str:
    """The page as text, with the figures of the comparison in it."""
    labels = [contender.label for contender in comparison.contenders]
    title = f"{' and '.join(labels) if len(labels) < 3 else f'{labels[0]} and {len(labels) - 1} others'} compared"
    hidden = (f"body:has(#show-{k}:not(:checked)) .series-{k}{{display:none}}\n" for k in range(len(labels)))
    return document(title, _sections(comparison, drawings), "".join(hidden))


def document(title: str, sections: Iterable[Markup | None], style: str = "") -> str:
    """An HTML file of sections below a title, with further rules of style.

    Its security policy allows styles and pictures inside it, which matplotlib's figures have; nothing else.
    """
    policy = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'"
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=policy),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="referrer", content="no-referrer"),
        tag("title", title),
        tag("style", Markup(_STYLE + style)),
    )
    body = tag("body", tag("h1", title), *sections)
    return f"<!doctype html>\n{tag('html', head, body, lang='en')}\n"


def _sections(comparison: Comparison, drawings: Sequence[Drawing]) -> list[Markup | None]:
    labels = [contender.label for contender in comparison.contenders]
    learning, seeds, density = drawings[:2], drawings[2:4], drawings[4:]
    return [
        tag("p", f"{sum(len(one.runs) for one in comparison.contenders)} runs, karolos {__version__}."),
        items("warnings", comparison.warnings) if comparison.warnings else None,
        _legend(labels),
        tag("h2", "Learning"),
        figure_grid(learning),
        tag("h2", "In numbers"),
        _contenders_table(scores_table(comparison)),
        items("notes", explanations(comparison)),
        tag("h2", "Settings that differ") if len(labels) > 1 else None,
        _contenders_table(parameters_table(comparison)) if comparison.parameters else None,
        tag("p", "The specs are the same.") if len(labels) > 1 and not comparison.parameters else None,
        tag("h2", "Seeds"),
        figure_grid(seeds),
        tag("h2", "Density of the success ratio over training"),
        tag(
            "p",
            "At each test the kernel density over the seeds, reflected at 0 and 1 and normalised by Simpson's rule. "
            "Darker is denser: shades follow the square root of the density and are the same in all figures. Bold: "
            "mean of the density; thin: 5 and 95 % of its mass are below."
            if density
            else f"{'Returns have' if comparison.metric == 'return' else 'A single seed has'} no density.",
        ),
        figure_grid(density),
        tag("h2", "Runs"),
        _runs_table(comparison),
    ]


def items(kind: str, lines: Iterable[str]) -> Markup:
    """A list of lines; kind: notes or warnings."""
    return tag("ul", *(tag("li", line) for line in lines), class_=kind)


def _legend(labels: Sequence[str]) -> Markup:
    """Check boxes that show or hide a contender, or the lines of single seeds; the style sheet does it."""
    entries = [
        tag("label", tag("input", type="checkbox", checked=True, id=f"show-{series}"), _swatch(series), label)
        for series, label in enumerate(labels)
    ]
    seeds = tag("label", tag("input", type="checkbox", checked=True, id="seeds"), "each seed")
    return tag("div", *entries, seeds, class_="legend")


def _swatch(series: int) -> Markup:
    """A piece of a contender's line."""
    dashes = " ".join(f"{2 * length:g}" for length in DASHES[series // len(COLOURS) % len(DASHES)]) or None
    colour = COLOURS[series % len(COLOURS)]
    line = tag("path", d="M1,5h24", stroke=colour, stroke_width=4, stroke_dasharray=dashes)
    return tag("svg", line, viewBox="0 0 26 10", class_="swatch")


def figure_grid(drawings: Sequence[Drawing]) -> Markup:
    """Figures side by side, as many as fit."""
    figures = []
    for drawing in drawings:
        series = None if drawing.series is None else f"series-{drawing.series}"
        figures.append(tag("figure", drawing.svg(), tag("figcaption", drawing.caption), class_=series))
    return tag("div", *figures, class_="figures")


def _contenders_table(table: Table) -> Markup:
    """A table whose first column names the rows and whose others are the contenders."""
    corner, *labels = table.columns
    head = [tag("th", corner), *(tag("th", _swatch(k), label, scope="col") for k, label in enumerate(labels))]
    return _table(head, [tag("tr", tag("th", name, scope="row"), *map(_cell, cells)) for name, *cells in table.rows])


def _runs_table(comparison: Comparison) -> Markup:
    columns: Columns[ComparedRun] = {
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
    }
    if not any(contender.has_success for contender in comparison.contenders):
        columns = {name: cell for name, cell in columns.items() if not name.startswith(("success", "best, end"))}
    runs = [(series, run) for series, contender in enumerate(comparison.contenders) for run in contender.runs]
    if any(run.summary.tags or run.summary.note for _, run in runs):
        columns["tags"] = lambda run: ", ".join(run.summary.tags)
        columns["note"] = lambda run: run.summary.note or ""
    table = Table.of((run for _, run in runs), columns)
    rows = [
        tag("tr", tag("td", _swatch(series), name), *map(_cell, cells), class_=f"series-{series}")
        for (series, _), (name, *cells) in zip(runs, table.rows, strict=True)
    ]
    return _table([tag("th", name, scope="col") for name in table.columns], rows)


def plain_table(table: Table) -> Markup:
    """A table whose first column names the rows."""
    head = [tag("th", name, scope="col") for name in table.columns]
    return _table(head, [tag("tr", tag("th", name, scope="row"), *map(_cell, cells)) for name, *cells in table.rows])


def _cell(text: str) -> Markup:
    """A cell; a long text may be broken, a number may not."""
    return tag("td", text, class_="long" if len(text) > 26 else None)


def _table(head: Sequence[Markup], rows: Sequence[Markup]) -> Markup:
    """A table that scrolls sideways by itself where the window is too narrow for it."""
    return tag("div", tag("table", tag("thead", tag("tr", *head)), tag("tbody", *rows)), class_="scroll", tabindex=0)
