"""Figures: how they look, how they are written into files, and how one stands inside a page."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from ..files import writing
from .markup import Markup
from .tables import clean

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

FORMATS = (".svg", ".pdf", ".png")
COLOURS = ("#0072b2", "#bf4a00", "#00805c", "#a03a80", "#8a6a00", "#5a5a5a")
"""Colours of the contenders, in order, after Okabe and Ito's set for colour-blind readers. They are darkened until each
stands out from white by 4.5 : 1, as text must."""
DASHES: tuple[tuple[float, ...], ...] = ((), (5, 2), (1.5, 1.5))
"""Dash patterns of the contenders: solid for the first six, dashed for the next six, then dotted."""
WIDTH, HEIGHT = 4.8, 3.4
"""Of a figure, in inches."""
FONT = 9
"""Size of its text, in points."""
LOOK: dict[Any, Any] = {
    "font.size": FONT,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.edgecolor": "#8a8a86",
    "axes.labelcolor": "#454545",
    "xtick.color": "#8a8a86",
    "ytick.color": "#8a8a86",
    "xtick.labelcolor": "#454545",
    "ytick.labelcolor": "#454545",
    "grid.color": "#e2e2de",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "savefig.dpi": 200,
    "text.parse_math": False,  # a name with two dollar signs is no formula
    "svg.hashsalt": "karolos",  # without it the ids in a file are random
    "svg.fonttype": "none",  # text stays text, which can be searched and edited
    "pdf.fonttype": 42,
}
_UNDATED = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}, ".png": {}}
_SVG, _XLINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}"


@contextmanager
def look() -> Iterator[None]:
    """The settings of matplotlib under which figures are drawn and written."""
    import matplotlib  # noqa: PLC0415  (takes half a second)

    with matplotlib.rc_context(LOOK), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from")  # a browser has fonts that matplotlib lacks
        yield


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format of the file's extension; the same figure gives the same bytes.

    Raises:
        MachineError: the file cannot be written.
    """
    with look(), writing(path):
        figure.savefig(path, metadata=_UNDATED[path.suffix])


def short(text: str, length: int = 28) -> str:
    """A name shortened in the middle, since names differ at their ends; control characters are replaced."""
    text = clean(text)
    if len(text) <= length:
        return text
    head = (length - 1) // 2
    return f"{text[:head]}…{text[len(text) - (length - 1 - head) :]}"


def style(series: int) -> dict[str, Any]:
    """Colour and dashes of a contender's lines."""
    dashes = DASHES[series // len(COLOURS) % len(DASHES)]
    return {"color": COLOURS[series % len(COLOURS)], "linestyle": (0, dashes) if dashes else "-"}


class Drawing:
    """A figure with one set of axes, whose parts a page can address by class.

    Args:
        name: of its files, without extension.
        title: stands above the axes.
        caption: stands below the figure in a page.
        series: the contender that the whole figure shows, if it shows only one.
    """

    def __init__(self, name: str, title: str, caption: str, series: int | None = None) -> None:
        from matplotlib.figure import Figure  # noqa: PLC0415  (takes half a second)

        self.name, self.title, self.caption, self.series = name, title, caption, series
        self.figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
        self.axes = self.figure.add_subplot()
        self.axes.set_title(short(title, 44))
        self.parts: dict[str, tuple[str, str]] = {}
        """Group id of an artist -> class names and tooltip of its element in the page."""

    def part(self, artist: Artist, classes: str, tooltip: str = "") -> None:
        """Give an artist class names and a tooltip in the page."""
        gid = f"part{len(self.parts)}"
        artist.set_gid(gid)
        self.parts[gid] = (classes, clean(tooltip))

    def legend(self, labels: Sequence[str]) -> None:
        """Name the contenders below the axes."""
        from matplotlib.lines import Line2D  # noqa: PLC0415

        lines = [Line2D([], [], **style(series), label=short(label)) for series, label in enumerate(labels)]
        legend = self.figure.legend(handles=lines, loc="outside lower center", ncols=min(len(labels), 2))
        for series, (line, text) in enumerate(zip(legend.legend_handles, legend.get_texts(), strict=True)):
            assert line is not None
            self.part(line, f"series-{series}")
            self.part(text, f"series-{series}")

    def resize(self, width: float, font: float) -> None:
        """Set the width in inches, keeping the proportions, and the size of the text in points."""
        from matplotlib.text import Text  # noqa: PLC0415

        if (width, font) == (WIDTH, FONT):
            return
        self.figure.set_size_inches(width, width * HEIGHT / WIDTH)
        for text in self.figure.findobj(Text):
            assert isinstance(text, Text)
            text.set_fontsize(float(text.get_fontsize()) * font / FONT)
        self.axes.tick_params(labelsize=font)  # of ticks that do not exist yet

    def write(self, folder: Path) -> list[Path]:
        """Write the figure into a folder in every format; returns the files."""
        paths = [folder / f"{self.name}{suffix}" for suffix in FORMATS]
        for path in paths:
            save(self.figure, path)
        return paths

    def svg(self) -> Markup:
        """The figure as an <svg> element for an HTML page with a strict security policy.

        Inline styles become presentation attributes, since the policy forbids the former. The groups of artists get
        their classes and tooltips. Ids begin with the figure's name, so that several figures fit into one page.
        """
        from io import StringIO  # noqa: PLC0415

        stream = StringIO()
        with look():
            self.figure.savefig(stream, format="svg", metadata={"Date": None})
        root = ElementTree.fromstring(stream.getvalue())
        for parent in list(root.iter()):
            for child in list(parent):
                if child.tag in (f"{_SVG}metadata", f"{_SVG}style"):
                    parent.remove(child)
        for element in root.iter():
            self._plain_element(element)
        size = {"viewBox": root.get("viewBox", ""), "role": "img", "aria-label": clean(self.title)}
        root.attrib.clear()
        root.attrib |= size | {"stroke-linejoin": "round", "stroke-linecap": "butt"}
        return Markup(ElementTree.tostring(root, "unicode"))

    def _plain_element(self, element: ElementTree.Element) -> None:
        element.tag = element.tag.removeprefix(_SVG)
        gid = element.get("id", "")
        attributes = {key.removeprefix(_XLINK): value for key, value in element.attrib.items()}
        for declaration in attributes.pop("style", "").split(";"):
            key, _, value = declaration.strip().partition(": ")
            if key == "font":
                *weight, size = value.split("px")[0].split()
                attributes |= {"font-size": size} | ({"font-weight": weight[0]} if weight else {})
            elif key:
                attributes[key] = value
        for key, value in attributes.items():
            if key == "href" and value.startswith("#"):
                attributes[key] = f"#{self.name}-{value[1:]}"
            attributes[key] = attributes[key].replace("url(#", f"url(#{self.name}-")
        if gid:
            attributes["id"] = f"{self.name}-{gid}"
        element.attrib.clear()
        element.attrib |= attributes
        if gid in self.parts:
            classes, tooltip = self.parts[gid]
            element.set("class", classes)
            if tooltip:
                title = ElementTree.Element("title")
                title.text = tooltip
                element.insert(0, title)
