"""A comparison in words and digits: the same cells for the terminal and for the page."""

from __future__ import annotations

from typing import Any

from ..comparison import MISSING, Comparison, Estimate, Improvement, Scores
from .tables import duration, setting

Row = tuple[str, tuple[str, ...]]
"""What is compared, and each contender's."""


def score_rows(comparison: Comparison) -> list[Row]:
    """One row per number, one cell per contender."""
    contenders, scores = comparison.contenders, comparison.scores
    chosen = comparison.success
    first = contenders[0].label

    def row(name: str, cells: list[str]) -> Row:
        return name, tuple(cells)

    rows = [
        row("experiment", [contender.experiment[:12] for contender in contenders]),
        row("seeds", [str(len(contender.runs)) for contender in contenders]),
        row("success any", [estimate(one.any) for one in scores]),
        row("success end", [estimate(one.end) for one in scores]),
        row(f"inter-quartile mean, {chosen}", [estimate(one.iqm) for one in scores]),
    ]
    if len(contenders) > 1:
        rows.append(row(f"better than {first}", [improvement(one.improvement) for one in scores]))
    for place, reaching in enumerate(scores[0].reaching):
        percent = f"{reaching.ratio * 100:g} %"
        rows.append(row(f"steps to {percent}", [_reached(one, place, "steps") for one in scores]))
        rows.append(row(f"time to {percent}", [_reached(one, place, "seconds") for one in scores]))
    if any(one.density for one in scores):
        rows.append(row("density over seeds", [_density(one) for one in scores]))
    rows += [
        row("steps of a run", [f"{one.steps:,.0f}" for one in scores]),
        row("time of a run", [duration(one.seconds) for one in scores]),
        row("updates per second", [_rate(one.updates_per_second) for one in scores]),
    ]
    return rows


def parameter_rows(comparison: Comparison) -> list[Row]:
    """The settings that differ, a cell per contender."""
    return [(path, tuple(map(cell, values))) for path, values in comparison.parameters.items()]


def explanations(comparison: Comparison) -> list[str]:
    """What the signs in the cells mean, as far as they occur."""
    scores = comparison.scores
    kinds = {one.any.kind for one in scores}
    found = ["success is that of the last test; the unit is the seed"]
    if "bootstrap" in kinds:
        found.append("[low, high]: 95 % bootstrap interval over 10 seeds or more")
    if "approximate" in kinds:
        found.append("~[low, high]: the same over 5 to 9 seeds, which covers less than 95 %")
    if "range" in kinds:
        found.append("(low - high): smallest and largest of 2 to 4 seeds, too few for an interval")
    if "wilson" in kinds:
        found.append("[low, high] of a single run: 95 % Wilson interval of its test, which says nothing about seeds")
    found.append(
        f"steps and time to: median over seeds of the first test with that success ({comparison.success}); "
        "(k of n) got there, - where half of them or more did not"
    )
    if len(scores) > 1:
        found.append("better than: probability that a run of it beats one of the first; .5 is no difference")
    if any(one.density for one in scores):
        found.append("density over seeds: its modes, and the range of 5 to 95 % of its mass")
    return found


def estimate(found: Estimate) -> str:
    """A ratio with its interval, whose brackets tell its kind."""
    if found.kind == "range":
        return f"{found.value:.3f} ({found.low:.3f} - {found.high:.3f})"
    sign = "~" if found.kind == "approximate" else ""
    return f"{found.value:.3f} {sign}[{found.low:.3f}, {found.high:.3f}]"


def improvement(found: Improvement | None) -> str:
    """A probability with its interval; - for the contender that the others are measured against."""
    if found is None:
        return "-"
    if found.low is None or found.high is None:
        return f"{found.probability:.2f}"
    return f"{found.probability:.2f} {'~' if found.approximate else ''}[{found.low:.2f}, {found.high:.2f}]"


def cell(value: Any) -> str:
    """A value of a spec as one would write it; - where the spec has no such key."""
    return "-" if value is MISSING else setting(value)


def _reached(scores: Scores, place: int, unit: str) -> str:
    found = scores.reaching[place]
    median = found.steps if unit == "steps" else found.seconds
    shown = "-" if median is None else f"{median:,.0f}" if unit == "steps" else duration(median)
    return f"{shown} ({found.reached} of {found.seeds})"


def _density(scores: Scores) -> str:
    found = scores.density
    if found is None:
        return "-"
    modes = " and ".join(f"{mode:.2f}" for mode in found.modes)
    return f"{modes}; {found.low:.2f} - {found.high:.2f}"


def _rate(rate: float | None) -> str:
    return "-" if rate is None else f"{rate:,.0f}"
