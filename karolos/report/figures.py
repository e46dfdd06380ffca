"""Charts as SVG and PDF files for papers: the same marks as on the page, drawn by matplotlib."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import MachineError
from ..files import writing
from .chart import LIGHT, Band, Chart, Dots, Line, Mark, Shades, short, spread

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = ("svg", "pdf")
INCHES = (4.6, 3.0)
"""Fits a column of a page."""
_STYLES = ("-", (0, (4, 2)), (0, (1, 1)))
_LINES: dict[str, dict[str, Any]] = {
    "seed": {"linewidth": 0.6, "alpha": 0.4},
    "main": {"linewidth": 1.8},
    "edge": {"linewidth": 0.7, "alpha": 0.8},
}
LOOK: dict[Any, Any] = {
    "font.size": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "svg.hashsalt": "karolos",  # or every file would differ from the one before
    "pdf.fonttype": 42,  # text that can be searched and edited
}
_UNDATED: dict[str, dict[str, Any]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
_LABEL_GAP = 0.062
"""Between two labels, as a share of the axis."""


def write_figures(charts: Iterable[Chart], folder: Path) -> tuple[Path, ...]:
    """Write each chart into `folder`, made if it is not there, as <name>.svg and <name>.pdf; returns the files.

    Raises:
        MachineError: they cannot be written.
    """
    import matplotlib  # noqa: PLC0415  (takes half a second)
    from matplotlib.figure import Figure  # noqa: PLC0415

    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    found: list[Path] = []
    with matplotlib.rc_context(LOOK):
        for chart in charts:
            figure = Figure(figsize=INCHES, layout="constrained")
            _draw(figure.add_subplot(), chart)
            found.extend(save(figure, folder, chart.name))
    return tuple(found)


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Write a figure into the folder in every format; returns the files.

    Raises:
        MachineError: they cannot be written.
    """
    found = []
    for ending in FORMATS:
        path = folder / f"{name}.{ending}"
        try:
            figure.savefig(path, metadata=_UNDATED[ending])
        except OSError as error:
            raise MachineError(f"cannot be written ({error.strerror})", where=str(path)) from error
        found.append(path)
    return found


def _draw(axes: Axes, chart: Chart) -> None:
    axes.set_title(_plain(chart.title))
    axes.set(xlabel=chart.across.label, ylabel=chart.up.label)
    axes.set_xlim(chart.across.low, chart.across.high)
    axes.set_ylim(chart.up.low, chart.up.high)
    axes.set_xticks([place for place, _ in chart.across.ticks], [text for _, text in chart.across.ticks])
    axes.set_yticks([place for place, _ in chart.up.ticks], [_plain(short(text)) for _, text in chart.up.ticks])
    axes.grid(axis="x" if chart.up.categories else "both", color="#d9d9d4", linewidth=0.6)
    for mark in chart.marks:
        _mark(axes, mark)
    low, high = chart.up.low, chart.up.high
    heights = spread([label.y for label in chart.labels], _LABEL_GAP * (high - low), low, high)
    for label, height in zip(chart.labels, heights, strict=True):
        axes.annotate(
            _plain(short(label.text)),
            (1.0, height),
            xycoords=axes.get_yaxis_transform(),
            xytext=(5, 0),
            textcoords="offset points",
            verticalalignment="center",
            color=_colour(label.series),
            fontweight="bold",
        )


def _mark(axes: Axes, mark: Mark) -> None:
    colour, dashes = _colour(mark.series), _STYLES[mark.series // len(LIGHT) % len(_STYLES)]
    match mark:
        case Line():
            axes.plot(mark.x, mark.y, color=colour, linestyle=dashes, **_LINES[mark.role])
        case Band():
            axes.fill_between(mark.x, mark.low, mark.high, color=colour, alpha=0.16, linewidth=0)
        case Dots():
            axes.plot(mark.x, mark.y, "o", color=colour, alpha=0.75, markersize=4, markeredgewidth=0, clip_on=False)
        case Shades():
            _shades(axes, mark, colour)


def _shades(axes: Axes, mark: Shades, colour: str) -> None:
    from matplotlib.colors import LinearSegmentedColormap  # noqa: PLC0415

    scale = LinearSegmentedColormap.from_list("shades", ["#ffffff", colour])
    heights = np.linspace(0, 1, mark.shades.shape[1])
    half = heights[1] / 2
    borders = np.clip(np.append(heights - half, 1 + half), 0, 1)
    mesh = axes.pcolormesh(mark.edges, borders, mark.shades.T, cmap=scale, vmin=0, vmax=1, linewidth=0)
    mesh.set_rasterized(True)  # thousands of rectangles show seams in many viewers


def _colour(series: int) -> str:
    return LIGHT[series % len(LIGHT)]


def _plain(text: str) -> str:
    """Text that matplotlib does not take for a formula."""
    return text.replace("$", r"\$")
