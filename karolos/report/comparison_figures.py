"""The figures of a comparison: learning curves, final success, performance profiles, densities over training."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..comparison import Comparison, Contender, Estimate, aggregates, learning_curve
from ..comparison.conditions import conditions, final_values
from ..comparison.curves import Axis, places
from ..core.seeding import SeedTree
from ..errors import UsageError, alternatives
from ..records.run_records import Metric
from .figures import COLOURS, HEIGHT, Drawing, file_name, look, short, style
from .tables import decimal, estimate, heading

_Floats = NDArray[np.float64]
HOVERED = 25
"""Number of points of a curve (at most about twice this) that show their values on hover."""
MOST_APART = 200
"""Largest number of seed lines, and of dots with names on hover: more cannot be distinguished."""
SPREAD_POINTS, SEEN = 201, 0.995
"""Number of points of a distribution, and the share of the episodes that it shows."""
WIDE = 8
"""Smallest ratio of the largest to the smallest value of a setting for a logarithmic axis."""
WHOLE = 0.6
"""Smallest part of 0 to 1 for which an axis of ratios shows the whole range."""
_SECONDS = ((7200, 3600, "h"), (120, 60, "min"), (0, 1, "s"))
"""Units of a time axis: smallest number of seconds for the unit, its name, and its seconds."""


_LABELS: dict[Metric, str] = {
    "any": "success ratio at any step",
    "end": "success ratio at the end",
    "return": "mean return of an episode",
}


def comparison_figures(comparison: Comparison, chosen: Collection[str] = ()) -> dict[str, list[Drawing]]:
    """The figures by kind, or those whose kind or name is chosen. Empty figures are left out.

    Raises UsageError if no figure has a chosen name.
    """
    drawn = {kind: [one for one in draw(comparison) if one.shows_something] for kind, draw in KINDS.items()}
    known = [*KINDS, *(one.name for drawings in drawn.values() for one in drawings)]
    if name := next((name for name in chosen if name not in known), None):
        raise UsageError(f"there is no figure {name!r}", where="--figure", hint=alternatives(name, known))
    wanted = {*(chosen or KINDS)}
    return {kind: [one for one in found if wanted & {kind, one.name}] for kind, found in drawn.items()}


def titled_curve(comparison: Comparison, title: str) -> Drawing:
    """Learning over steps, for a page with several such figures."""
    drawing = learning(comparison, "steps")
    drawing.name = file_name(title)
    drawing.axes.set_title(title, loc="left")
    return drawing


@look()
def learning(comparison: Comparison, axis: Axis) -> Drawing:
    """Success or return over training: seeds as thin lines, (inter-quartile) mean bold, its interval as a band."""
    contenders, metric = comparison.contenders, comparison.metric
    robust = min(len(contender.runs) for contender in contenders) >= aggregates.FEW_SEEDS
    statistic, name = (aggregates.iqm, "inter-quartile mean") if robust else (aggregates.mean, "mean")
    tree = SeedTree(0).child("report", axis)
    drawing = Drawing(
        f"{comparison.what}_over_{axis}",
        f"{comparison.what.title()} over {'environment steps' if axis == 'steps' else 'wall-clock time'}",
        f"Bold: {name} over seeds; thin: each seed. Band: 95 % bootstrap interval for 5 seeds or more (approximate "
        "below 10), smallest to largest for 2 to 4 seeds, Wilson interval for one run.",
    )
    axes, scale = drawing.axes, _x_axis(drawing, contenders, axis)
    for series, contender in enumerate(contenders):
        curve = learning_curve(contender.runs, axis, metric, statistic, tree.child(series).generator())
        colour, at = style(series)["color"], curve.at / scale
        band = axes.fill_between(at, curve.low, curve.high, color=colour, alpha=0.16, linewidth=0)
        drawing.part(band, f"band series-{series}")
        names = [_run_text(contender, place) for place in range(len(contender.runs))]
        _seeds(drawing, series, [(places(run, axis) / scale, run.values(metric)) for run in contender.runs], names)
        alone = "o" if at.size == 1 else ""  # a single point would be invisible
        [line] = axes.plot(at, curve.middle, **style(series), linewidth=2, marker=alone, zorder=3)
        drawing.part(line, f"main series-{series}", f"{contender.label}: {name}")
        for place in range(0, at.size, at.size // HOVERED + 1):
            middle, low, high = (ends[place] for ends in (curve.middle, curve.low, curve.high))
            [dot] = axes.plot(at[place], middle, "o", color=colour, alpha=0, markersize=9, zorder=4)
            text = f"{contender.label} at {curve.at[place]:,.0f} {axis}: {middle:.3f}, {low:.3f} to {high:.3f}"
            drawing.part(dot, f"value series-{series}", text)
    _metric_axis(drawing, "y", comparison)
    drawing.legend(comparison.labels)
    return drawing


@look()
def final(comparison: Comparison) -> Drawing:
    """The reported success or return of every seed as a dot, with mean and interval below as a cross."""
    drawing = Drawing(
        f"final_{comparison.what}",
        f"{comparison.what.title()} at the end of training",
        "A dot is a seed. Below: mean and its interval (95 %; smallest to largest for 2 to 4 seeds).",
    )
    drawing.figure.set_figheight(max(HEIGHT, 1 + 0.25 * len(comparison.labels)))
    low, high = _ends(comparison)
    estimates = [
        {"any": scores.any, "end": scores.end, "return": scores.returns}[comparison.metric]
        for scores in comparison.scores
    ]
    values = [[run.reported(comparison.metric) for run in contender.runs] for contender in comparison.contenders]
    _dots(drawing, comparison, values, estimates, high - low)
    _metric_axis(drawing, "x", comparison)
    return drawing


@look()
def measure_figures(comparison: Comparison) -> list[Drawing]:
    """For each measure of a contender: every seed as a dot, mean and interval below, as in `final`.

    Behind them stands the distribution of each measure over the episodes.
    """
    drawings = []
    for name, one in comparison.measures.items():
        estimates = [scores.measures.get(name) for scores in comparison.scores]
        known = [found for found in estimates if found is not None]
        span = max((found.high for found in known), default=0) - min((found.low for found in known), default=0)
        if not span:
            continue  # a single run, or a force of 0 in all of them
        drawing = Drawing(file_name(f"measure_{name}"), name, f"The {one['better']} the better.")
        drawing.figure.set_figheight(1 + 0.5 * len(estimates))
        values = [[run.measured(name) for run in contender.runs] for contender in comparison.contenders]
        _dots(drawing, comparison, values, estimates, span)
        _value_axis(drawing, "x", heading(name, one), ratio=False)
        drawings.append(drawing)
    finals = [[final_values(run) for run in contender.runs] for contender in comparison.contenders]
    return drawings + [one for name in comparison.measures for one in _spread(comparison, name, finals)]


def _spread(
    comparison: Comparison, name: str, episodes: Sequence[Sequence[Mapping[str, Sequence[float]]]]
) -> list[Drawing]:
    """Draw the distribution of a measure over the episodes of the final tests, if a folder holds them."""
    finals = [[values.get(name, ()) for values in runs] for runs in episodes]
    known = [np.sort(values) for runs in finals for values in runs if len(values)]
    if not known:
        return []
    caption = "Share of the final test's episodes with at most this value. Bold: mean over seeds; thin: each seed."
    drawing = Drawing(file_name(f"measure_{name}_spread"), f"{name}, episode by episode", caption)
    low, high = min(float(one[0]) for one in known), max(float(np.quantile(one, SEEN)) for one in known)
    if low == high:
        return []
    at = np.linspace(low, high, SPREAD_POINTS)
    for series, runs in enumerate(finals):
        shares = [np.searchsorted(np.sort(values), at, side="right") / len(values) for values in runs if len(values)]
        if len(shares) > 1:
            _seeds(drawing, series, [(at, share) for share in shares])
        if shares:
            [line] = drawing.axes.plot(at, np.mean(shares, 0), **style(series), linewidth=2)
            drawing.part(line, f"main series-{series}", comparison.labels[series])
    _value_axis(drawing, "y", "share of episodes")
    _value_axis(drawing, "x", heading(name, comparison.measures[name]), ratio=False)
    drawing.legend(comparison.labels)
    return [drawing]


@look()
def condition_figures(comparison: Comparison) -> list[Drawing]:
    """Success over each setting that tests changed: mean over seeds and its interval."""
    tree = SeedTree(0).child("conditions")
    found = [conditions(one, tree.child(place)) for place, one in enumerate(comparison.contenders)]
    drawings = []
    for setting in sorted({setting for one in found for setting in one}):
        caption = "Tests of policies with other values of this setting. Mean over seeds with its interval (95 %)."
        drawing = Drawing(file_name(f"over_{setting}"), f"Success over {setting}", caption)
        every = [value for one in found if setting in one for value in one[setting].success]
        for series, one in enumerate(found):
            if setting not in one:
                continue
            points = one[setting].success
            drawing.caption += "".join(f" {comparison.labels[series]}: {note}" for note in one[setting].notes)
            at, ends = list(points), list(points.values())
            band = drawing.axes.fill_between(
                at, [end.low for end in ends], [end.high for end in ends], color=style(series)["color"], alpha=0.16
            )
            drawing.part(band, f"band series-{series}")
            [line] = drawing.axes.plot(at, [end.value for end in ends], **style(series), linewidth=2)
            drawing.part(line, f"main series-{series}", comparison.labels[series])
            for value, end in points.items():
                [dot] = drawing.axes.plot(value, end.value, "o", color=style(series)["color"], markersize=4.5)
                drawing.part(dot, f"dot series-{series}", f"{comparison.labels[series]} at {value:g}: {estimate(end)}")
        if min(every) > 0 and max(every) >= WIDE * min(every):
            drawing.axes.set_xscale("log")
        _value_axis(drawing, "x", setting, ratio=False)
        _value_axis(drawing, "y", _LABELS["end"])
        drawing.legend(comparison.labels)
        drawings.append(drawing)
    return drawings


def _seeds(
    drawing: Drawing, series: int, lines: Sequence[tuple[_Floats, Sequence[float] | _Floats]], names: Sequence[str] = ()
) -> None:
    """A thin line for each seed of a contender, or for some if there are many. `names` appear on hover."""
    every = math.ceil(len(lines) / MOST_APART)
    for place, (x, y) in list(enumerate(lines))[::every]:
        [line] = drawing.axes.plot(x, y, **style(series), linewidth=0.6, alpha=0.45)
        drawing.part(line, f"seed series-{series}", names[place] if names else "")
    if every > 1:
        drawing.caption += f" One line for {every} of the {len(lines):,} seeds is shown."


def _dots(
    drawing: Drawing,
    comparison: Comparison,
    values: Sequence[Sequence[float | None]],
    estimates: Sequence[Estimate | None],
    span: float,
) -> None:
    """A row for each contender: the value of every seed as a dot, below them the estimate as a cross.

    `values` are those of the runs of each contender; None: no dot or cross. `span` of the axis separates nearly equal
    dots.
    """
    axes, count = drawing.axes, len(comparison.contenders)
    for series, (contender, found) in enumerate(zip(comparison.contenders, estimates, strict=True)):
        dots = np.array(values[series], float)  # None becomes nan
        row, colour = count - series, style(series)["color"]
        heights = row + _offsets(dots, span or 1.0)
        texts = [f"{_run_text(contender, place)}, {x:.4g}" for place, x in enumerate(dots)]
        points = list(zip(dots[:, None], heights[:, None], texts, strict=True))
        if dots.size > MOST_APART:
            points = [(dots, heights, f"{contender.label}: {dots.size:,} seeds")]
        for x, y, text in points:
            [dot] = axes.plot(x, y, "o", color=colour, alpha=0.75, markersize=4.5, markeredgewidth=0, clip_on=False)
            drawing.part(dot, f"dot series-{series}", text)
        if found is None:
            continue
        [line] = axes.plot([found.low, found.high], [row - 0.3] * 2, color=colour, linewidth=1.2)
        drawing.part(line, f"edge series-{series}")
        [tick] = axes.plot([found.value] * 2, [row - 0.38, row - 0.22], color=colour, linewidth=2.2)
        text = f"{contender.label}: mean {found.value:.3f}, {found.low:.3f} to {found.high:.3f}"
        drawing.part(tick, f"main series-{series}", text)
    axes.set_yticks(range(count, 0, -1), [short(label, 22) for label in comparison.labels])
    axes.set_ylim(0.4, count + 0.6)
    axes.tick_params(axis="y", length=0)


@look()
def profiles(comparison: Comparison) -> Drawing:
    """Performance profile: the fraction of seeds with at least the success or return on the axis."""
    drawing = Drawing(
        "performance_profiles",
        "Performance profiles",
        f"Fraction of seeds with at least that {comparison.what} at the end of training. A curve above another is "
        "better.",
    )
    for series, contender in enumerate(comparison.contenders):
        values = [run.reported(comparison.metric) for run in contender.runs]
        thresholds = np.unique([*values, *_ends(comparison)])
        if np.isnan(values).all() or thresholds.size == 1:
            continue  # the figure would be empty
        # The fraction at t holds from the threshold before t up to t.
        [line] = drawing.axes.step(
            thresholds, aggregates.profile(values, thresholds), where="pre", **style(series), linewidth=2
        )
        drawing.part(line, f"main series-{series}", contender.label)
    _metric_axis(drawing, "x", comparison, "at least this ")
    _value_axis(drawing, "y", "fraction of seeds")
    drawing.legend(comparison.labels)
    return drawing


@look()
def density_figures(comparison: Comparison) -> list[Drawing]:
    """The density of the success ratio over training, one figure for each contender with two or more seeds.

    As in figures 3 and 4 of the Karolos paper: at each test the kernel density over the seeds. All figures have one
    scale of shades and one of steps.
    """
    from matplotlib.colors import LinearSegmentedColormap  # noqa: PLC0415  (takes half a second)

    found = {series: scores.over_steps for series, scores in enumerate(comparison.scores) if scores.over_steps}
    several = {series: comparison.contenders[series] for series in found}
    peak = max((float(one.density.max()) for _, each in found.values() for one in each), default=1.0)
    drawings, names = [], [file_name(label) for label in comparison.labels]
    for series, (at, each) in found.items():
        contender, name = several[series], names[series]
        drawing = Drawing(
            f"density_{name}{f'_{series + 1}' * (names.count(name) > 1)}",
            contender.label,
            f"{len(contender.runs)} seeds. Darkest: a density of {peak:.0f}.",
            series,
        )
        axes = drawing.axes
        _x_axis(drawing, list(several.values()), "steps")
        # The square root keeps a density of 1 (no information) visible next to one of 40.
        shades = np.sqrt(np.stack([one.density for one in each], axis=1) / peak)
        heights = np.linspace(0, 1, len(shades))
        borders = np.clip(np.append(heights, heights[-1] + heights[1]) - heights[1] / 2, 0, 1)
        colours = LinearSegmentedColormap.from_list("shades", ["#ffffff", COLOURS[series % len(COLOURS)]])
        mesh = axes.pcolormesh(_columns(at), borders, shades, cmap=colours, vmin=0, vmax=1, linewidth=0)
        mesh.set_rasterized(True)  # thousands of rectangles show seams in many viewers
        lines = {"low": "5 % of the mass is below", "high": "95 % of the mass is below", "mean": "mean of the density"}
        for key, text in lines.items():
            classes, width = ("main", 2.0) if key == "mean" else ("edge", 0.8)
            [line] = axes.plot(at, [getattr(one, key) for one in each], color=style(series)["color"], linewidth=width)
            drawing.part(line, classes, text)
        ends = [(one.low, one.high) for _, each in found.values() for one in each]
        _metric_axis(drawing, "y", comparison, data=(min(low for low, _ in ends), max(high for _, high in ends)))
        drawings.append(drawing)
    return drawings


KINDS: dict[str, Callable[[Comparison], list[Drawing]]] = {
    "steps": lambda comparison: [learning(comparison, "steps")],
    "time": lambda comparison: [learning(comparison, "seconds")],
    "final": lambda comparison: [final(comparison)],
    "profiles": lambda comparison: [profiles(comparison)],
    "densities": density_figures,
    "measures": measure_figures,
    "settings": condition_figures,
}
"""All figures: learning twice, the seeds twice, and one for each contender, measure and tested setting."""


def heat_map(
    drawing: Drawing,
    rows: Sequence[tuple[str, Sequence[Estimate | None]]],
    columns: Sequence[str],
    *,
    neutral: float | None = None,
    larger_is_better: bool = True,
) -> None:
    """Draw estimates as shaded cells: rows of a label and an estimate for each column.

    Values better than `neutral` are blue, worse ones red, fully at a distance of 1. Without it shades go from 0 to 1.
    """
    from matplotlib.colors import LinearSegmentedColormap  # noqa: PLC0415  (takes half a second)

    values = np.array([[np.nan if cell is None else cell.value for cell in cells] for _, cells in rows])
    shades, low, colours = values, 0, ["#ffffff", COLOURS[0]]
    if neutral is not None:
        shades = np.clip(values - neutral, -1, 1) * (1 if larger_is_better else -1)
        low, colours = -1, [COLOURS[1], *colours]
    axes, shading = drawing.axes, LinearSegmentedColormap.from_list("shades", colours)
    mesh = axes.pcolormesh(np.ma.masked_invalid(shades), cmap=shading, vmin=low, vmax=1, edgecolors="#fff", linewidth=2)
    legend = drawing.figure.colorbar(mesh, ax=axes, ticks=(low, 0, 1), shrink=0.8, aspect=14)
    offset, sign = neutral or 0.0, -1 if neutral is not None and not larger_is_better else 1
    legend.set_ticklabels([f"{offset + sign * tick:g}" for tick in (low, 0, 1)])
    legend.outline.set_visible(False)
    for row, (label, cells) in enumerate(rows):
        for column, cell in enumerate(cells):
            text, colour = (
                "-" if cell is None else decimal(cell.value),
                "#ffffff" if abs(shades[row, column]) > 0.6 else "#1c1c1c",
            )
            drawn = axes.text(column + 0.5, row + 0.5, text, ha="center", va="center", color=colour)
            drawing.part(drawn, "cell", f"{label} to {columns[column]}: {estimate(cell)}")
    axes.set_xticks(np.arange(len(columns)) + 0.5, [short(label, 14) for label in columns])
    axes.set_yticks(np.arange(len(rows)) + 0.5, [short(label, 14) for label, _ in rows])
    axes.invert_yaxis()
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_facecolor("#f6f6f4")


def _x_axis(drawing: Drawing, contenders: Sequence[Contender], axis: Axis) -> float:
    """Set the x axis from 0 to the last test of all runs. Returns the steps or seconds per unit of the axis."""
    from matplotlib.ticker import EngFormatter  # noqa: PLC0415  (takes half a second)

    high = max(float(places(run, axis)[-1]) for contender in contenders for run in contender.runs)
    scale, label = 1, "environment steps"
    if axis == "seconds":
        scale, unit = next((scale, unit) for least, scale, unit in _SECONDS if high >= least)
        label = f"time of collecting and learning ({unit})"
    else:
        drawing.axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    drawing.axes.set_xlim(0, (high or 1.0) / scale)
    drawing.axes.set_xlabel(label)
    drawing.axes.grid()
    return scale


def _metric_axis(
    drawing: Drawing,
    axis: Literal["x", "y"],
    comparison: Comparison,
    before: str = "",
    data: tuple[float, float] | None = None,
) -> None:
    """Set the axis of the compared quantity. For a ratio it shows the part of 0 to 1 with the data, and says so.

    Lines on its border are not cut.

    `data`: the smallest and the largest ratio; None: those of the drawn lines.
    """
    low, high = data or (drawing.axes.dataLim.intervaly if axis == "y" else drawing.axes.dataLim.intervalx)
    margin = max(0.06 * (high - low), 0.003)
    low, high = max(low - margin, 0), min(high + margin, 1)
    part = (low, high) if drawing.shows_something and high - low <= WHOLE else None
    ratio = comparison.metric != "return"
    _value_axis(drawing, axis, f"{before}{_LABELS[comparison.metric]}", ratio=ratio, part=part)
    drawing.caption += f" The axis shows {low:.2g} to {high:.2g} only." if ratio and part else ""


def _value_axis(
    drawing: Drawing,
    axis: Literal["x", "y"],
    label: str,
    *,
    ratio: bool = True,
    part: tuple[float, float] | None = None,
) -> None:
    """Set an axis with grid lines. For a ratio it is a part of 0 to 1 or all of it. Lines on its border are not cut."""
    drawing.axes.set(**{f"{axis}label": label})
    if ratio:
        drawing.axes.set(**{f"{axis}lim": part or (0, 1)} | ({} if part else {f"{axis}ticks": (0, 0.25, 0.5, 0.75, 1)}))
        for line in drawing.axes.lines:
            line.set_clip_on(False)
    drawing.axes.grid(visible=True, axis=axis)


def _columns(at: _Floats) -> _Floats:
    """Borders of a column around each of some ascending steps: (t,) to (t + 1,). The last column ends at its step."""
    first = at[0] - (at[1] - at[0]) / 2 if at.size > 1 else at[0] * 0.9
    return np.concatenate([[max(first, 0.0)], (at[1:] + at[:-1]) / 2, [at[-1]]])


def _ends(comparison: Comparison) -> tuple[float, float]:
    """Smallest and largest reported success or return of a run; 0 if none is finite."""
    reported = [run.reported(comparison.metric) for contender in comparison.contenders for run in contender.runs]
    known = [value for value in reported if not math.isnan(value)]
    return min(known, default=0.0), max(known, default=0.0)


def _run_text(contender: Contender, place: int) -> str:
    run = contender.runs[place].summary
    return f"{contender.label}, seed {run.seed}: {run.run} ({run.state})"


def _offsets(values: _Floats, span: float) -> _Floats:
    """Vertical offsets that separate equal values: each further dot with about the same value is .09 higher.

    Values count as about the same if they differ by at most a 40th of `span`.
    """
    seen: dict[int, int] = {}
    offsets = []
    for value in np.nan_to_num(values):
        key = round(float(value) / span * 40)
        offsets.append(min(0.09 * seen.setdefault(key, 0), 0.6) - 0.1)
        seen[key] += 1
    return np.array(offsets)
