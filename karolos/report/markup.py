"""HTML and SVG elements whose texts and attributes are always escaped."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape


class Markup(str):
    """Text that is markup already. Only `tag` and `join` make it, and whoever writes a constant."""

    __slots__ = ()


def tag(name: str, /, *children: object, **attributes: object) -> Markup:
    """An element. Children that are not Markup are shown as text; None and False leave a child or attribute out.

    Attributes: `class_` for class, underscores become hyphens, True is an attribute without a value.
    """
    written = "".join(_attribute(key, value) for key, value in attributes.items() if not _nothing(value))
    inside = join(children)
    return Markup(f"<{name}{written}/>" if name in _EMPTY else f"<{name}{written}>{inside}</{name}>")


def join(children: Iterable[object]) -> Markup:
    """Children one after the other, escaped unless they are Markup."""
    return Markup("".join(_child(child) for child in children if not _nothing(child)))


_EMPTY = frozenset({"meta", "br", "input", "rect", "path", "line", "circle", "stop"})

_BLANKS = "\n\N{NO-BREAK SPACE}"


def _nothing(value: object) -> bool:
    return value is None or value is False  # 0 is something


def _child(child: object) -> str:
    return child if isinstance(child, Markup) else escape(_shown(child))


def _attribute(key: str, value: object) -> str:
    name = key.rstrip("_").replace("_", "-")
    return f" {name}" if value is True else f' {name}="{escape(_shown(value))}"'


def _shown(value: object) -> str:
    """Without control characters and marks that reorder a line, which HTML cannot escape."""
    text = f"{value:.5g}" if isinstance(value, float) else str(value)
    return "".join(sign if sign.isprintable() or sign in _BLANKS else "\N{REPLACEMENT CHARACTER}" for sign in text)
