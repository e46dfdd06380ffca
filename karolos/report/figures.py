"""Figures: their style, their files, and their form inside a page."""

from __future__ import annotations

import re
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from math import ceil, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..system.files import writing
from .tables import clean

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

STYLE = Path(__file__).with_suffix(".mplstyle")
FORMATS = (".svg", ".pdf", ".png")
COLOURS = ("#0072b2", "#bf4a00", "#00805c", "#a03a80", "#8a6a00", "#5a5a5a")
"""Colours of the contenders, in order, after Okabe and Ito's set for colour-blind readers. They are darkened until the
contrast to white is 4.5 : 1, as for text."""
DASHES: tuple[tuple[float, ...], ...] = ((), (5, 2), (1.5, 1.5))
"""Dash patterns of the contenders: solid for the first six, dashed for the next six, then dotted."""
WIDTH, HEIGHT = 4.8, 3.4
"""Size of a figure, in inches."""
FONT = 9
"""Size of its text in points, as in the style."""
_UNDATED = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}, ".png": {}}


_LOOKING = threading.RLock()


@contextmanager
def look() -> Iterator[None]:
    """The settings of matplotlib for drawing and writing figures. Only one thread at a time uses them."""
    import matplotlib  # noqa: PLC0415  (takes half a second)

    with _LOOKING, matplotlib.rc_context(fname=STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from")  # a browser has fonts that matplotlib lacks
        yield


def short(text: str, length: int = 28) -> str:
    """A name shortened in the middle, because names differ at their ends. Control characters are replaced."""
    text = clean(text)
    if len(text) <= length:
        return text
    head = (length - 1) // 2
    return f"{text[:head]}…{text[len(text) - (length - 1 - head) :]}"


def file_name(text: str) -> str:
    """A text as part of the name of a file."""
    return re.sub(r"[^\w.-]+", "_", text)[:100]


def style(series: int) -> dict[str, Any]:
    """Colour and dashes of a contender's lines, for matplotlib."""
    dashes = DASHES[series // len(COLOURS) % len(DASHES)]
    return {"color": COLOURS[series % len(COLOURS)], "linestyle": (0, dashes or None)}


class Drawing:
    """A figure with one set of axes, whose parts a page can address by class.

    `name` is that of its files, without extension. In a page the caption stands below it. `series` is the contender
    that the whole figure shows, if it shows only one.
    """

    def __init__(self, name: str, title: str, caption: str, series: int | None = None) -> None:
        from matplotlib.figure import Figure  # noqa: PLC0415  (takes half a second)

        self.name, self.title, self.caption, self.series = name, title, caption, series
        self.figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
        self.axes = self.figure.add_subplot()
        self.axes.set_title(short(title, 44))
        self._names: list[str] = []
        self._legend_height = 0.0
        self.parts: dict[str, tuple[str, str]] = {}
        """Group id of an artist -> class names and tooltip of its element in the page."""

    @property
    def shows_something(self) -> bool:
        """Whether anything was drawn on the axes. A return that is not a number has no place there."""
        return bool(isfinite(self.axes.dataLim.x1 + self.axes.dataLim.y1))

    def part(self, artist: Artist, classes: str, tooltip: str = "") -> None:
        """Give an artist class names and a tooltip in the page."""
        gid = f"part{len(self.parts)}"
        artist.set_gid(gid)
        self.parts[gid] = (classes, clean(tooltip))

    def legend(self, labels: Sequence[str]) -> None:
        """Name the contenders below the axes."""
        self._names = [short(label) for label in labels]
        self._draw_legend(WIDTH, FONT)

    def _draw_legend(self, width: float, font: float) -> None:
        """Draw the legend with the columns that fit, and give the figure the height of its rows after the third."""
        from matplotlib.lines import Line2D  # noqa: PLC0415

        # A letter is about .62 of the font size wide, line and gaps of a column 3.6; a row is 1.5 high.
        fits = 2 * (0.62 * max(map(len, self._names)) + 3.6) * font <= width * 72
        columns = min(len(self._names), 2 if fits else 1)
        height = max(ceil(len(self._names) / columns) - 3, 0) * 1.5 * font / 72
        self.figure.set_figheight(self.figure.get_figheight() + height - self._legend_height)
        self._legend_height = height
        self.figure.legends.clear()
        lines = [Line2D([], [], **style(series), label=name) for series, name in enumerate(self._names)]
        with look():
            legend = self.figure.legend(handles=lines, loc="outside lower center", ncols=columns, fontsize=font)
        for series, (line, text) in enumerate(zip(legend.legend_handles, legend.get_texts(), strict=True)):
            assert line is not None
            self.part(line, f"series-{series}")
            self.part(text, f"series-{series}")

    def resize(self, width: float, font: float) -> None:
        """Set the width in inches, keeping the proportions, and the size of the text in points."""
        from matplotlib.text import Text  # noqa: PLC0415

        if (width, font) == (WIDTH, FONT):
            return
        now, height = self.figure.get_size_inches()
        self.figure.set_size_inches(width, (height - self._legend_height) * width / now + self._legend_height)
        for text in self.figure.findobj(Text):
            assert isinstance(text, Text)
            text.set_fontsize(float(text.get_fontsize()) * font / FONT)
        self.axes.tick_params(labelsize=font)  # of ticks that do not exist yet
        if self._names:
            self._draw_legend(width, font)

    def save(self, path: Path) -> Path:
        """Write the figure in the format of the file's extension; the same figure gives the same bytes.

        Raises MachineError if the file cannot be written.
        """
        with look(), writing(path):
            self.figure.savefig(path, metadata=_UNDATED[path.suffix])
        return path

    def svg(self, *, legend: bool = True) -> str:
        """The figure as an <svg> element for an HTML page. The groups of artists get their classes and tooltips.

        `legend`: whether it is shown; a page of contenders has one for all figures.
        Other ids are hashes salted with the figure's name, so that several figures fit into one page.
        """
        from io import StringIO  # noqa: PLC0415

        import matplotlib  # noqa: PLC0415

        stream = StringIO()
        legends, height = [*self.figure.legends], self.figure.get_figheight()
        if not legend:
            self.figure.legends.clear()
            self.figure.set_figheight(height - self._legend_height)
        with look(), matplotlib.rc_context({"svg.hashsalt": self.name}):
            self.figure.savefig(stream, format="svg", metadata={"Date": None})
        self.figure.legends[:] = legends
        self.figure.set_figheight(height)
        text = re.sub(r"<metadata>.*?</metadata>| xmlns(:xlink)?=\S+\"", "", stream.getvalue(), flags=re.DOTALL)
        for gid, (classes, tooltip) in self.parts.items():
            title = f"<title>{escape(tooltip)}</title>" if tooltip else ""
            text = text.replace(f'<g id="{gid}">', f'<g class="{classes}">{title}')
        text = re.sub(r' id="[a-z0-9.]+_\d+"', "", text.replace("xlink:href", "href"))  # ids without references
        label = escape(clean(self.title))
        return f'<svg role="img" aria-label="{label}"{text[text.index("<svg") + len("<svg") :].rstrip()}'


def write_plots(plots: Mapping[str, Figure], folder: Path) -> None:
    """Write figures of pyplot into `folder` as SVG, PDF and PNG, and close them. Raises MachineError."""
    from matplotlib import pyplot, rc_context  # noqa: PLC0415

    with writing(folder), rc_context({"text.parse_math": True}):  # of logarithmic axes
        folder.mkdir(parents=True, exist_ok=True)
        for name, figure in plots.items():
            for suffix in FORMATS:
                figure.savefig(folder / f"{name}{suffix}", metadata=_UNDATED[suffix], bbox_inches="tight")
            pyplot.close(figure)


def write_figures(drawings: Sequence[Drawing], folder: Path, *, width: float = WIDTH, font: float = FONT) -> list[Path]:
    """Write figures into `folder` as SVG, PDF and PNG; returns the files. A missing folder is created.

    `width` is that of a figure in inches, the height follows. `font` is the size of the text in points. The drawings
    keep both. Raises MachineError if they cannot be written.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for drawing in drawings:
        drawing.resize(width, font)
    return [drawing.save(folder / f"{drawing.name}{suffix}") for drawing in drawings for suffix in FORMATS]
