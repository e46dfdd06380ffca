"""Figures of a sweep: its history, what mattered, and where the good trials lie, from plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..files import writing
from ..spec.sweep import OBJECTIVES, SweepParameter
from .figures import look, save
from .tables import clean

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INCHES = (9.2, 6.2)
_COLOUR, _BEST, _PALE = "#2f6db3", "#c0504d", "#9aa0a6"


class SearchTrial(Protocol):
    """What of a trial is drawn."""

    @property
    def number(self) -> int: ...
    @property
    def state(self) -> str: ...
    @property
    def drawn(self) -> Mapping[str, Any]: ...
    @property
    def values(self) -> tuple[float, ...] | None: ...


def write_search_figures(
    trials: Sequence[SearchTrial],
    objective: str,
    space: Mapping[str, SweepParameter],
    importances: Mapping[str, float],
    folder: Path,
) -> tuple[Path, ...]:
    """Write search.svg and search.pdf into `folder`, made if it is not there; returns the files.

    Args:
        trials: all of the sweep; one at least is complete.
        objective: name of the first objective, which is drawn.
        space: parameter -> where it was searched.
        importances: parameter -> share; may be empty.

    Raises:
        MachineError: they cannot be written.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    paths = tuple(folder / f"search.{suffix}" for suffix in ("svg", "pdf"))
    with look():
        from matplotlib.figure import Figure  # noqa: PLC0415  (takes half a second)

        figure = Figure(figsize=INCHES, layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(3, 2))
        _history(figure.add_subplot(grid[0, 0]), trials, objective)
        _importances(figure.add_subplot(grid[0, 1]), importances)
        _parallel(figure.add_subplot(grid[1, :]), trials, objective, space)
        for path in paths:
            save(figure, path)
    return paths


def _first(trial: SearchTrial) -> float:
    assert trial.values is not None  # complete trials only
    return trial.values[0]


def _complete(trials: Sequence[SearchTrial]) -> list[SearchTrial]:
    return [trial for trial in trials if trial.values is not None]


def _history(axes: Axes, trials: Sequence[SearchTrial], objective: str) -> None:
    from matplotlib.ticker import MaxNLocator  # noqa: PLC0415

    done = _complete(trials)
    numbers, values = [trial.number for trial in done], np.array([_first(trial) for trial in done])
    best = (np.maximum if OBJECTIVES[objective] == "maximize" else np.minimum).accumulate(values)
    axes.plot(numbers, values, "o", color=_COLOUR, markersize=4, alpha=0.8, label="trial")
    axes.step(numbers, best, where="post", color=_BEST, linewidth=1.5, label="best so far")
    for state, mark in (("pruned", "|"), ("failed", "x")):
        places = [trial.number for trial in trials if trial.state == state]
        if places:
            axes.plot(
                places, [0.02] * len(places), mark, color=_PALE, transform=axes.get_xaxis_transform(), label=state
            )
    axes.set(title="History", xlabel="trial", ylabel=objective)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(frameon=False)


def _importances(axes: Axes, importances: Mapping[str, float]) -> None:
    axes.set_title("Importance (PED-ANOVA)")
    if not importances:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "too few trials that differ", ha="center", va="center", transform=axes.transAxes)
        return
    ordered = sorted(importances.items(), key=lambda one: one[1])
    bars = axes.barh([clean(name) for name, _ in ordered], [share for _, share in ordered], color=_COLOUR)
    axes.bar_label(bars, fmt="%.2f", padding=2)
    axes.set_xlim(0, 1.15 * max(importances.values()))


def _parallel(axes: Axes, trials: Sequence[SearchTrial], objective: str, space: Mapping[str, SweepParameter]) -> None:
    """A line per complete trial across all parameters; where a parameter was not drawn the line is broken."""
    done = _complete(trials)
    values = np.array([_first(trial) for trial in done])
    low, high = float(values.min()), float(values.max())
    good = (values - low) / (high - low) if high > low else np.full(len(values), 0.5)
    shades = good if OBJECTIVES[objective] == "maximize" else 1 - good
    for place in np.argsort(shades, kind="stable"):  # the best on top
        trial, shade = done[place], float(shades[place])
        heights = [good[place], *(_height(space[key], trial.drawn.get(key)) for key in space)]
        axes.plot(heights, color=_COLOUR if shade < 1 else _BEST, alpha=0.15 + 0.85 * shade**2, linewidth=0.8 + shade)
    ticks = [[(0.0, f"{low:.3g}"), (1.0, f"{high:.3g}")], *(_ticks(parameter) for parameter in space.values())]
    for across, marks in enumerate(ticks):
        axes.axvline(across, color=_PALE, linewidth=0.8, zorder=0)
        for height, text in marks:
            axes.annotate(clean(text), (across, height), xytext=(3, 3), textcoords="offset points")
    axes.set_xticks(range(len(ticks)), [clean(name) for name in (objective, *space)])
    axes.tick_params(axis="x", length=0)
    axes.set_yticks([])
    axes.set_ylim(-0.02, 1.06)
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.set_title("Parallel coordinates")


def _height(parameter: SweepParameter, drawn: Any) -> float:
    """Where a value lies between the ends of its parameter, from 0 to 1; nan where it was not drawn."""
    if drawn is None:
        return float("nan")
    if parameter.choice is not None:
        return parameter.labels.index(drawn) / (len(parameter.labels) - 1)
    low, high = parameter.bounds
    if parameter.log:
        return float(np.log(drawn / low) / np.log(high / low))
    return float((drawn - low) / (high - low))


def _ticks(parameter: SweepParameter) -> list[tuple[float, str]]:
    """Heights and words beside a parameter's axis: every choice, or the ends of a range."""
    if parameter.choice is not None:
        return [(_height(parameter, label), label) for label in parameter.labels]
    low, high = parameter.bounds
    return [(0.0, f"{low:g}"), (1.0, f"{high:g}")]
