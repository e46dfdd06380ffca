"""The figures of a comparison: learning curves, densities over training, performance profiles, final success."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..comparison import Comparison, Contender, densities, learning_curve
from ..comparison.curves import Axis as Along
from ..comparison.curves import places
from ..core.seeding import SeedTree
from ..statistics import aggregates
from ..statistics.density import Density
from .chart import Axis, Band, Chart, Dots, Label, Line, Mark, Shades, ratio_axis, seconds_axis, steps_axis

_Floats = NDArray[np.float64]


def charts(comparison: Comparison) -> Iterator[Chart]:
    """Every figure, in the order of the page."""
    yield learning(comparison, "steps")
    yield learning(comparison, "seconds")
    yield final(comparison)
    yield profiles(comparison)
    yield from density_charts(comparison)


def learning(comparison: Comparison, axis: Along) -> Chart:
    """Success over training: every seed thin, their mean or inter-quartile mean bold, with its band."""
    contenders, success = comparison.contenders, comparison.success
    robust = min(len(contender.runs) for contender in contenders) >= aggregates.FEW_SEEDS
    statistic, said = (aggregates.iqm, "inter-quartile mean") if robust else (aggregates.mean, "mean")
    tree = SeedTree(0).child("report", axis)
    bands: list[Mark] = []
    seeds: list[Mark] = []
    bold: list[Mark] = []
    labels = []
    for series, contender in enumerate(contenders):
        curve = learning_curve(contender.runs, axis, success, statistic, tree.child(series).generator())
        bands.append(Band(curve.at, curve.low, curve.high, series))
        seeds += [
            Line(places(run, axis), np.array(run.ratios(success)), series, "seed", _told(contender, place))
            for place, run in enumerate(contender.runs)
        ]
        bold.append(Line(curve.at, curve.middle, series, "main", f"{contender.label}: {said}"))
        labels.append(Label(float(curve.middle[-1]), contender.label, series))
    high = max(float(places(run, axis)[-1]) for contender in contenders for run in contender.runs)
    return Chart(
        name=f"success_over_{axis}",
        title=f"Success over {'environment steps' if axis == 'steps' else 'wall-clock time'}",
        caption=f"Bold: {said} over seeds; thin: each seed. Band: 95 % bootstrap interval from 5 seeds (approximate "
        "below 10), from 2 to 4 seeds their range, for one run its Wilson interval.",
        across=steps_axis(high) if axis == "steps" else seconds_axis(high),
        up=_success_axis(comparison),
        marks=(*bands, *seeds, *bold),
        labels=tuple(labels),
    )


def final(comparison: Comparison) -> Chart:
    """The last test of every seed as a dot, and mean with interval as a cross beside them."""
    marks: list[Mark] = []
    count = len(comparison.contenders)
    for series, (contender, scores) in enumerate(zip(comparison.contenders, comparison.scores, strict=True)):
        estimate = scores.any if comparison.success == "any" else scores.end
        values = np.array([run.last(comparison.success) for run in contender.runs])
        row = float(count - series)
        told = [_told(contender, place) for place in range(len(contender.runs))]
        marks.append(Dots(values, np.full(values.size, row) + _beside(values), series, told))
        marks.append(Line(np.array([estimate.low, estimate.high]), np.full(2, row - 0.3), series, "edge"))
        said = f"{contender.label}: mean {estimate.value:.3f}, {estimate.low:.3f} to {estimate.high:.3f}"
        marks.append(Line(np.full(2, estimate.value), row - 0.3 + np.array([-0.1, 0.1]), series, "main", said))
    names = tuple((float(count - series), contender.label) for series, contender in enumerate(comparison.contenders))
    return Chart(
        name="final_success",
        title="Success at the last test",
        caption="A dot is a seed. Below: mean and its interval (95 %; from 2 to 4 seeds the range).",
        across=ratio_axis(_success_axis(comparison).label),
        up=Axis("", 0.4, count + 0.5, names, categories=True),
        marks=tuple(marks),
    )


def profiles(comparison: Comparison) -> Chart:
    """Performance profile: the share of seeds whose last test shows at least the success on the axis."""
    marks: list[Mark] = []
    labels = []
    for series, contender in enumerate(comparison.contenders):
        values = [run.last(comparison.success) for run in contender.runs]
        thresholds = np.unique([0.0, *values, 1.0])
        shares = aggregates.profile(values, thresholds)
        # A step function, continuous from the left: the share at t holds from the threshold before it up to t.
        x, y = np.repeat(thresholds, 2)[:-1], np.repeat(shares, 2)[1:]
        marks.append(Line(x, y, series, "main", contender.label))
        labels.append(Label(float(shares[-1]), contender.label, series))
    return Chart(
        name="performance_profiles",
        title="Performance profiles",
        caption="Share of seeds whose last test shows at least that success. A curve above another is better.",
        across=ratio_axis(f"at least this {_success_axis(comparison).label}"),
        up=ratio_axis("share of seeds"),
        marks=tuple(marks),
        labels=tuple(labels),
    )


def density_charts(comparison: Comparison) -> Iterator[Chart]:
    """The density of the success ratio over training, one chart per contender of two seeds and more.

    As in figures 3 and 4 of the Karolos paper: at each test the kernel density over the seeds. One scale of shades for
    all of them.
    """
    found = {
        series: densities(contender.runs, comparison.success)
        for series, contender in enumerate(comparison.contenders)
        if len(contender.runs) > 1
    }
    peak = max((float(one.density.max()) for _, each in found.values() for one in each), default=1.0)
    high = max((float(at[-1]) for at, _ in found.values()), default=1.0)
    for series, (at, each) in found.items():
        contender = comparison.contenders[series]
        yield Chart(
            name=f"density_{series + 1}",
            title=contender.label,
            caption=f"{len(contender.runs)} seeds. Darkest: a density of {peak:.0f}.",
            across=steps_axis(high),
            up=_success_axis(comparison),
            marks=_density_marks(at, each, series, peak),
        )


def _density_marks(at: _Floats, each: tuple[Density, ...], series: int, peak: float) -> tuple[Mark, ...]:
    between = (at[1:] + at[:-1]) / 2
    first = at[0] - (at[1] - at[0]) / 2 if at.size > 1 else at[0] * 0.9
    edges = np.concatenate([[max(first, 0.0)], between, [at[-1]]])
    # The root lets a density of 1, which is no knowledge at all, be seen beside one of 40.
    shades = np.sqrt(np.stack([one.density for one in each]) / peak)
    low, high, mean = (np.array([getattr(one, key) for one in each]) for key in ("low", "high", "mean"))
    return (
        Shades(edges, shades, series),
        Line(at, low, series, "edge", "5 % of the mass lie below"),
        Line(at, high, series, "edge", "95 % of the mass lie below"),
        Line(at, mean, series, "main", "mean of the density"),
    )


def _success_axis(comparison: Comparison) -> Axis:
    return ratio_axis("success ratio" if comparison.success == "any" else "success ratio at the end")


def _told(contender: Contender, place: int) -> str:
    run = contender.runs[place].summary
    return f"{contender.label}, seed {run.seed}: {run.run} ({run.state})"


def _beside(values: _Floats) -> _Floats:
    """Offsets that keep equal values apart: 0, .1, .2 ... of a row, the later ones above."""
    seen: dict[int, int] = {}
    offsets = []
    for value in values:
        key = round(float(value) * 40)
        offsets.append(min(0.09 * seen.setdefault(key, 0), 0.6) - 0.1)
        seen[key] += 1
    return np.array(offsets)
