"""Charts as inline SVG that takes its colours from the page's style sheet: see `style`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from .chart import DASHES, LIGHT, Band, Chart, Dots, Label, Line, Mark, Shades, short, spread
from .markup import Markup, join, tag

WIDTH, HEIGHT = 460.0, 300.0
TOP, BOTTOM, LEFT = 10.0, 46.0, 48.0
SIGN = 8.6
"""Width of a bold letter at the largest size that the style sheet gives to text, 13 units."""
LINE_GAP = 15.0
STOPS = 0.01
"""Shades are drawn this exactly, in parts of the darkest."""

_Floats = NDArray[np.float64]


def draw(chart: Chart) -> Markup:
    """The chart as one <svg> that scales with its container."""
    return tag(
        "svg",
        tag("title", chart.title),
        *_Drawing(chart).parts(),
        viewBox=f"0 0 {WIDTH:g} {HEIGHT:g}",
        role="img",
        aria_label=chart.title,
    )


def series_classes(series: int) -> str:
    """Class names that give a mark its colour, its dashes, and let the page hide it."""
    return f"c{series % len(LIGHT)} d{series // len(LIGHT) % len(DASHES)} s{series}"


class _Drawing:
    """One chart's way from data to units of the view box."""

    def __init__(self, chart: Chart) -> None:
        self.chart = chart
        left = max((len(short(text)) for _, text in chart.up.ticks), default=0) if chart.up.categories else 0
        self.left = max(LEFT, left * SIGN + 14)
        right = max((len(short(label.text)) for label in chart.labels), default=0)
        self.right = WIDTH - (right * SIGN + 10 if right else 14)
        self.bottom = HEIGHT - BOTTOM

    def parts(self) -> Iterator[Markup]:
        """Grid and axes below, marks in their order, labels on top."""
        yield from self._axes()
        for place, mark in enumerate(self.chart.marks):
            yield self._mark(mark, f"{self.chart.name}-{place}")
        yield from self._labels(self.chart.labels)

    def _x(self, value: float) -> float:
        axis = self.chart.across
        return self.left + (value - axis.low) / (axis.high - axis.low) * (self.right - self.left)

    def _y(self, value: float) -> float:
        axis = self.chart.up
        return self.bottom - (value - axis.low) / (axis.high - axis.low) * (self.bottom - TOP)

    def _points(self, x: _Floats, y: _Floats) -> str:
        return " ".join(f"{self._x(one):.1f},{self._y(other):.1f}" for one, other in zip(x, y, strict=True))

    def _axes(self) -> Iterator[Markup]:
        across, up = self.chart.across, self.chart.up
        for value, text in up.ticks:
            height = self._y(value)
            if not up.categories:
                yield tag("line", class_="grid", x1=self.left, x2=self.right, y1=height, y2=height)
            shown = short(text)
            yield tag("text", shown, x=self.left - 7, y=height, dy="0.32em", class_="tick end")
        for value, text in across.ticks:
            place = self._x(value)
            yield tag("line", class_="grid", x1=place, x2=place, y1=TOP, y2=self.bottom)
            yield tag("text", text, x=place, y=self.bottom + 17, class_="tick middle")
        middle = (self.left + self.right) / 2
        yield tag("text", across.label, x=middle, y=HEIGHT - 7, class_="axis middle")
        if up.label:
            height = (TOP + self.bottom) / 2
            yield tag("text", up.label, transform=f"translate(12 {height:g}) rotate(-90)", class_="axis middle")

    def _mark(self, mark: Mark, name: str) -> Markup:
        shown = series_classes(mark.series)
        match mark:
            case Line():
                title = tag("title", mark.label) if mark.label else None
                return tag("polyline", title, points=self._points(mark.x, mark.y), class_=f"{mark.role} {shown}")
            case Band():
                x, y = np.concatenate([mark.x, mark.x[::-1]]), np.concatenate([mark.high, mark.low[::-1]])
                return tag("polygon", points=self._points(x, y), class_=f"band {shown}")
            case Dots():
                dots = zip(mark.x, mark.y, mark.labels, strict=True)
                return tag("g", *(self._dot(x, y, label) for x, y, label in dots), class_=f"dots {shown}")
            case Shades():
                return self._shades(mark, name)

    def _dot(self, x: float, y: float, label: str) -> Markup:
        place = f"M{self._x(x):.1f},{self._y(y):.1f}h0"  # a line of no length with round ends is a dot
        return tag("g", tag("title", label), tag("path", d=place))

    def _shades(self, mark: Shades, name: str) -> Markup:
        top, bottom = self._y(1.0), self._y(0.0)
        gradients, columns = [], []
        for place, shades in enumerate(mark.shades):
            left, right = self._x(mark.edges[place]), self._x(mark.edges[place + 1])
            key = f"{name}-{place}"
            gradients.append(tag("linearGradient", *_stops(shades), id=key, x1=0, y1=1, x2=0, y2=0))
            rect = {"x": f"{left:.2f}", "y": top, "width": f"{right - left:.2f}", "height": bottom - top}
            columns.append(tag("rect", fill=f"url(#{key})", **rect))
        return tag("g", join(gradients), *columns, class_=f"shades {series_classes(mark.series)}")

    def _labels(self, labels: Sequence[Label]) -> Iterator[Markup]:
        heights = spread([self._y(label.y) for label in labels], LINE_GAP, TOP + 5, self.bottom - 3)
        for label, height in zip(labels, heights, strict=True):
            yield tag(
                "text",
                tag("title", label.text),
                short(label.text),
                x=self.right + 6,
                y=height,
                dy="0.32em",
                class_=f"label {series_classes(label.series)}",
            )


def _stops(shades: _Floats) -> list[Markup]:
    """Stops of a gradient that follows the shades, as few as the eye needs."""
    kept = _simplified(shades)
    last = shades.size - 1
    return [tag("stop", offset=f"{place / last:.3g}", stop_opacity=f"{shades[place]:.2f}") for place in kept]


def _simplified(heights: _Floats) -> list[int]:
    """Places between which straight lines keep within STOPS of the heights (Ramer, Douglas, Peucker)."""
    kept = {0, heights.size - 1}
    waiting = [(0, heights.size - 1)]
    while waiting:
        first, last = waiting.pop()
        if last - first < 2:
            continue
        line = np.interp(np.arange(first, last + 1), [first, last], heights[[first, last]])
        off = np.abs(heights[first : last + 1] - line)
        worst = int(off.argmax())
        if off[worst] > STOPS:
            kept.add(first + worst)
            waiting += [(first, first + worst), (first + worst, last)]
    return sorted(kept)
