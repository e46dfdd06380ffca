"""Heat maps: a value in each cell of rows and columns, with its shade."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .figures import COLOURS, Drawing, short


def shade_cells(
    drawing: Drawing,
    rows: Sequence[tuple[str, Sequence[tuple[float, str]]]],
    columns: Sequence[str],
    *,
    neutral: float | None = None,
    larger_is_better: bool = True,
) -> None:
    """Draw a heat map.

    Args:
        drawing: an empty one.
        rows: label, and for each cell value (nan if it is unknown) and text.
        columns: their labels.
        neutral: value without shade; better values are blue, worse ones red, fully at a distance of 1. None: shades
            from 0 to 1.
        larger_is_better: whether larger values are better.
    """
    from matplotlib.colors import LinearSegmentedColormap  # noqa: PLC0415  (takes half a second)

    values = np.array([[value for value, _ in cells] for _, cells in rows])
    shades, low, colours = values, 0, ["#ffffff", COLOURS[0]]
    if neutral is not None:
        shades = np.clip(values - neutral, -1, 1) * (1 if larger_is_better else -1)
        low, colours = -1, [COLOURS[1], *colours]
    axes, shading = drawing.axes, LinearSegmentedColormap.from_list("shades", colours)
    axes.pcolormesh(np.ma.masked_invalid(shades), cmap=shading, vmin=low, vmax=1, edgecolors="#ffffff", linewidth=2)
    for row, (label, cells) in enumerate(rows):
        for column, (value, text) in enumerate(cells):
            number, dark = "-" if np.isnan(value) else f"{value:.3f}", abs(shades[row, column]) > 0.6
            colour = "#ffffff" if dark else "#1c1c1c"
            drawn = axes.text(column + 0.5, row + 0.5, number, ha="center", va="center", color=colour)
            drawing.part(drawn, "cell", f"{label} to {columns[column]}: {text}")
    axes.set_xticks(np.arange(len(columns)) + 0.5, [short(label, 14) for label in columns])
    axes.set_yticks(np.arange(len(rows)) + 0.5, [short(label, 14) for label, _ in rows])
    axes.invert_yaxis()
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_facecolor("#f6f6f4")
