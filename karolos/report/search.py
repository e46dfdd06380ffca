"""Figures of a sweep: its history, the importance of its parameters, and the settings of all trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..records.sweep_records import SweepRecord, Trial
from ..specification.sweep import SweepParameter
from .figures import COLOURS, WIDTH, Drawing, look
from .tables import clean

_PALE = "#9aa0a6"


@look()
def search_figures(
    sweep: SweepRecord, space: Mapping[str, SweepParameter], importances: Mapping[str, float]
) -> list[Drawing]:
    """The figures of the first objective: `history`, `importances` and `parallel`.

    Args:
        sweep: with its trials, at least one of them complete.
        space: parameter -> range or choices that the sweep searches.
        importances: parameter -> fraction of the variance that it explains; may be empty.
    """
    return [_history(sweep), _importances(importances), _parallel(sweep, space)]


def _values(trials: Sequence[Trial]) -> dict[int, float]:
    """Number of each complete trial -> its first objective."""
    return {trial.number: trial.values[0] for trial in trials if trial.values is not None}


def _history(sweep: SweepRecord) -> Drawing:
    """The objective of each complete trial, the best so far, and marks for pruned and failed trials."""
    from matplotlib.ticker import MaxNLocator  # noqa: PLC0415  (takes half a second)

    drawing, values = Drawing("history", "History", "Pruned and failed trials have marks below."), _values(sweep.trials)
    axes, numbers = drawing.axes, list(values)
    best = (np.maximum if sweep.directions[0] == "maximize" else np.minimum).accumulate(list(values.values()))
    axes.plot(numbers, list(values.values()), "o", color=COLOURS[0], markersize=4, alpha=0.8, label="trial")
    axes.step(numbers, best, where="post", color=COLOURS[1], linewidth=1.5, label="best so far")
    for state, mark in (("pruned", "|"), ("failed", "x")):
        if ended := [trial.number for trial in sweep.trials if trial.state == state]:
            low = [0.02] * len(ended)
            axes.plot(ended, low, mark, color=_PALE, transform=axes.get_xaxis_transform(), label=state)
    axes.set(xlabel="trial", ylabel=sweep.objectives[0])
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    drawing.figure.legend(loc="outside lower center", ncols=4)
    return drawing


def _importances(importances: Mapping[str, float]) -> Drawing:
    drawing = Drawing("importances", "Importance (PED-ANOVA)", "The fraction of the variance that each explains.")
    axes = drawing.axes
    if not importances:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "too few trials that differ", ha="center", va="center", transform=axes.transAxes)
        return drawing
    names = sorted(importances, key=lambda name: importances[name])
    bars = axes.barh([clean(name) for name in names], [importances[name] for name in names], color=COLOURS[0])
    axes.bar_label(bars, fmt="%.2f", padding=2)
    axes.set_xlim(0, 1.15 * max(importances.values()))
    return drawing


def _parallel(sweep: SweepRecord, space: Mapping[str, SweepParameter]) -> Drawing:
    """One line per complete trial across all parameters. It is broken at a parameter that the trial did not draw."""
    drawing, values = Drawing("parallel", "Parallel coordinates", "The best trial stands out."), _values(sweep.trials)
    drawing.figure.set_size_inches(2 * WIDTH, drawing.figure.get_figheight())
    axes, low, high = drawing.axes, min(values.values()), max(values.values())
    drawn = {trial.number: trial.drawn for trial in sweep.trials}
    heights = {number: (value - low) / (high - low) if high > low else 0.5 for number, value in values.items()}
    maximize = sweep.directions[0] == "maximize"
    for number in sorted(values, key=lambda one: values[one], reverse=not maximize):  # the best on top
        shade = heights[number] if maximize else 1 - heights[number]
        line = [heights[number], *(_height(parameter, drawn[number].get(key)) for key, parameter in space.items())]
        colour = COLOURS[1] if shade == 1 else COLOURS[0]
        axes.plot(line, color=colour, alpha=0.15 + 0.85 * shade**2, linewidth=0.8 + shade)
    marks = [(0, 0.0, f"{low:.3g}"), (0, 1.0, f"{high:.3g}")]
    for place, parameter in enumerate(space.values(), 1):
        ends = parameter.labels or [f"{end:g}" for end in parameter.bounds]  # every choice, or the ends of a range
        marks += [(place, height, text) for height, text in zip(np.linspace(0, 1, len(ends)), ends, strict=True)]
    for place, height, text in marks:
        axes.annotate(clean(text), (place, height), xytext=(3, 3), textcoords="offset points")
    for place in range(len(space) + 1):
        axes.axvline(place, color=_PALE, linewidth=0.8, zorder=0)
    axes.set_xticks(range(len(space) + 1), [clean(name) for name in (sweep.objectives[0], *space)])
    axes.tick_params(axis="x", length=0)
    axes.set(yticks=[], ylim=(-0.02, 1.06))
    axes.spines[["left", "bottom"]].set_visible(False)
    return drawing


def _height(parameter: SweepParameter, drawn: Any) -> float:
    """Position of a value between the ends of its parameter, from 0 to 1; nan if it was not drawn."""
    if drawn is None:
        return float("nan")
    labels = parameter.labels
    low, high, value = (0, len(labels) - 1, labels.index(drawn)) if labels else (*parameter.bounds, drawn)
    if parameter.log:
        low, high, value = np.log((low, high, value))
    return float((value - low) / (high - low))
