"""What a figure shows, apart from how it is drawn: `svg` draws it for the page, `figures` into files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]

LIGHT = ("#0072b2", "#bf4a00", "#00805c", "#a03a80", "#8a6a00", "#5a5a5a")
"""Colours of the contenders, in order, after Okabe and Ito's set for colour-blind readers; darkened until each stands
out from the page by 4.5 : 1, as text must. A seventh contender begins again, dashed."""
DARK = ("#56b4e9", "#ff9147", "#2fd3a2", "#e58cc8", "#e6cf4a", "#b8b8b8")
"""The same hues on a dark ground."""
DASHES = ("", "6,3", "2,2")


@dataclass(frozen=True)
class Line:
    """A polyline. `role`: a single seed, all of them together, or the edge of a range."""

    x: _Floats
    y: _Floats
    series: int
    role: Literal["seed", "main", "edge"]
    label: str = ""


@dataclass(frozen=True)
class Band:
    """The area between two lines."""

    x: _Floats
    low: _Floats
    high: _Floats
    series: int


@dataclass(frozen=True)
class Dots:
    """Points with what each stands for."""

    x: _Floats
    y: _Floats
    series: int
    labels: Sequence[str]


@dataclass(frozen=True)
class Shades:
    """Densities over y in columns over x: shades[k] (101,) from y = 0 to 1 fills edges[k] .. edges[k + 1]; 0 to 1."""

    edges: _Floats
    shades: _Floats
    series: int


@dataclass(frozen=True)
class Label:
    """A name beside what it names, at the right of the plot."""

    y: float
    text: str
    series: int


Mark = Line | Band | Dots | Shades


@dataclass(frozen=True)
class Axis:
    """`ticks`: places with their texts. `categories`: ticks name things, so that there is no grid."""

    label: str
    low: float
    high: float
    ticks: tuple[tuple[float, str], ...]
    categories: bool = False


@dataclass(frozen=True)
class Chart:
    """One set of axes. `name` is that of its file; marks are drawn in order."""

    name: str
    title: str
    caption: str
    across: Axis
    up: Axis
    marks: tuple[Mark, ...]
    labels: tuple[Label, ...] = ()


def ratio_axis(label: str) -> Axis:
    """From 0 to 1, with room for what lies on the border."""
    return Axis(label, -0.03, 1.03, tuple((tick, f"{tick:g}") for tick in (0.0, 0.25, 0.5, 0.75, 1.0)))


def steps_axis(high: float) -> Axis:
    """Environment steps from 0, in thousands or millions where that is shorter."""
    divisor, unit = (1e6, " (millions)") if high >= 2e6 else (1e3, " (thousands)") if high >= 2e3 else (1.0, "")
    return _axis(f"environment steps{unit}", high, divisor)


def seconds_axis(high: float) -> Axis:
    """Wall-clock time from 0."""
    divisor, unit = (3600.0, "h") if high >= 2 * 3600 else (60.0, "min") if high >= 2 * 60 else (1.0, "s")
    return _axis(f"time of collecting and learning ({unit})", high, divisor)


def _axis(label: str, high: float, divisor: float) -> Axis:
    high = high or 1.0
    step = _tidy(high / divisor / 5) * divisor
    ticks = [k * step for k in range(int(high / step + 1e-9) + 1)]
    return Axis(label, 0.0, high, tuple((tick, f"{tick / divisor:g}") for tick in ticks))


def _tidy(step: float) -> float:
    """The smallest of 1, 2, 5 times a power of ten that is not below a step."""
    power = 10.0 ** math.floor(math.log10(step))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= step * (1 - 1e-9))


def short(text: str, length: int = 16) -> str:
    """A name that fits beside a line: its middle is left out, since names differ at their ends."""
    if len(text) <= length:
        return text
    head = (length - 1) // 2
    return f"{text[:head]}…{text[len(text) - (length - 1 - head) :]}"


def spread(heights: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """Heights moved apart until neighbours are `gap` away, as little as can be, inside low .. high where they fit.

    Least squares: what is over the gaps has to rise, which is isotonic regression (pool adjacent violators).
    """
    order = sorted(range(len(heights)), key=lambda place: heights[place])
    pools: list[tuple[float, int]] = []  # mean and number of labels that touch
    for rank, place in enumerate(order):
        mean, size = heights[place] - rank * gap, 1
        while pools and pools[-1][0] > mean:
            before, others = pools.pop()
            mean, size = (before * others + mean * size) / (others + size), others + size
        pools.append((mean, size))
    over = [mean for mean, size in pools for _ in range(size)]
    room = max(high - (len(heights) - 1) * gap, low)
    found = [0.0] * len(heights)
    for rank, place in enumerate(order):
        found[place] = min(max(over[rank], low), room) + rank * gap
    return found
