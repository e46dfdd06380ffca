"""Figures of a sweep: its history, the importance of its parameters, and the settings of all trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..files import writing
from ..records.sweep_records import Trial
from ..specification.sweep import OBJECTIVES, SweepParameter
from .figures import look, save
from .tables import clean

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOUR, _BEST, _PALE = "#2f6db3", "#c0504d", "#9aa0a6"


@look()
def write_search_figures(
    trials: Sequence[Trial],
    objective: str,
    space: Mapping[str, SweepParameter],
    importances: Mapping[str, float],
    folder: Path,
) -> None:
    """Write search.svg and search.pdf into `folder`, which is made if it is missing.

    Args:
        trials: all trials of the sweep, at least one of them complete.
        objective: name of the first objective, which is drawn.
        space: parameter -> range or choices that the sweep searches.
        importances: parameter -> fraction of the variance that it explains; may be empty.
        folder: where to write.

    Raises:
        MachineError: the files cannot be written.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415  (takes half a second)

    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    complete = [trial for trial in trials if trial.values is not None]
    values = np.array([trial.values[0] for trial in complete if trial.values is not None])
    figure = Figure(figsize=(9.2, 6.2), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(3, 2))
    history, importance, parallel = (figure.add_subplot(grid[place]) for place in ((0, 0), (0, 1), (1, slice(None))))
    _history(history, trials, [trial.number for trial in complete], values, objective)
    _importances(importance, importances)
    _parallel(parallel, complete, values, objective, space)
    for suffix in ("svg", "pdf"):
        save(figure, folder / f"search.{suffix}")


def _history(
    axes: Axes, trials: Sequence[Trial], complete: Sequence[int], values: NDArray[np.float64], objective: str
) -> None:
    """The objective of each complete trial, the best so far, and marks for pruned and failed trials."""
    from matplotlib.ticker import MaxNLocator  # noqa: PLC0415

    best = (np.maximum if OBJECTIVES[objective] == "maximize" else np.minimum).accumulate(values)
    axes.plot(complete, values, "o", color=_COLOUR, markersize=4, alpha=0.8, label="trial")
    axes.step(complete, best, where="post", color=_BEST, linewidth=1.5, label="best so far")
    for state, mark in (("pruned", "|"), ("failed", "x")):
        numbers = [trial.number for trial in trials if trial.state == state]
        if numbers:
            heights = [0.02] * len(numbers)
            axes.plot(numbers, heights, mark, color=_PALE, transform=axes.get_xaxis_transform(), label=state)
    axes.set(title="History", xlabel="trial", ylabel=objective)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(frameon=False)


def _importances(axes: Axes, importances: Mapping[str, float]) -> None:
    axes.set_title("Importance (PED-ANOVA)")
    if not importances:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "too few trials that differ", ha="center", va="center", transform=axes.transAxes)
        return
    names = sorted(importances, key=lambda name: importances[name])
    bars = axes.barh([clean(name) for name in names], [importances[name] for name in names], color=_COLOUR)
    axes.bar_label(bars, fmt="%.2f", padding=2)
    axes.set_xlim(0, 1.15 * max(importances.values()))


def _parallel(
    axes: Axes,
    complete: Sequence[Trial],
    values: NDArray[np.float64],
    objective: str,
    space: Mapping[str, SweepParameter],
) -> None:
    """One line per complete trial across all parameters. It is broken at a parameter that the trial did not draw."""
    low, high = float(values.min()), float(values.max())
    scaled = (values - low) / (high - low) if high > low else np.full(len(values), 0.5)
    shades = scaled if OBJECTIVES[objective] == "maximize" else 1 - scaled
    for place in np.argsort(shades, kind="stable"):  # the best on top
        shade = float(shades[place])
        drawn = complete[place].drawn
        heights = [scaled[place], *(_height(space[key], drawn.get(key)) for key in space)]
        axes.plot(heights, color=_COLOUR if shade < 1 else _BEST, alpha=0.15 + 0.85 * shade**2, linewidth=0.8 + shade)
    ticks = [[(0.0, f"{low:.3g}"), (1.0, f"{high:.3g}")], *(_ticks(parameter) for parameter in space.values())]
    for place, marks in enumerate(ticks):
        axes.axvline(place, color=_PALE, linewidth=0.8, zorder=0)
        for height, text in marks:
            axes.annotate(clean(text), (place, height), xytext=(3, 3), textcoords="offset points")
    axes.set_xticks(range(len(ticks)), [clean(name) for name in (objective, *space)])
    axes.tick_params(axis="x", length=0)
    axes.set(title="Parallel coordinates", yticks=[], ylim=(-0.02, 1.06))
    axes.spines[["left", "bottom"]].set_visible(False)


def _height(parameter: SweepParameter, drawn: Any) -> float:
    """Position of a value between the ends of its parameter, from 0 to 1; nan if it was not drawn."""
    if drawn is None:
        return float("nan")
    if parameter.choice is not None:
        return parameter.labels.index(drawn) / (len(parameter.labels) - 1)
    low, high = parameter.bounds
    if parameter.log:
        return float(np.log(drawn / low) / np.log(high / low))
    return float((drawn - low) / (high - low))


def _ticks(parameter: SweepParameter) -> list[tuple[float, str]]:
    """Heights and texts beside a parameter's axis: every choice, or the ends of a range."""
    if parameter.choice is not None:
        return [(_height(parameter, label), label) for label in parameter.labels]
    low, high = parameter.bounds
    return [(0.0, f"{low:g}"), (1.0, f"{high:g}")]
