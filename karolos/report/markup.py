"""HTML and SVG elements whose texts and attributes are always escaped."""

from __future__ import annotations

from html import escape

from .tables import clean

_EMPTY = frozenset({"meta", "input", "path"})


class Markup(str):
    """Text that is markup already. Only `tag` makes it, and code that writes a constant."""

    __slots__ = ()


def tag(name: str, /, *children: object, **attributes: object) -> Markup:
    """An element. Children that are not Markup are shown as text; None and False leave a child or attribute out.

    Attributes: `class_` for class, underscores become hyphens, True is an attribute without a value.
    """
    inside = "".join(
        child if isinstance(child, Markup) else _escaped(child)
        for child in children
        if child is not None and child is not False  # 0 is shown
    )
    written = "".join(
        f" {key.rstrip('_').replace('_', '-')}" + ("" if value is True else f'="{_escaped(value)}"')
        for key, value in attributes.items()
        if value is not None and value is not False
    )
    return Markup(f"<{name}{written}/>" if name in _EMPTY else f"<{name}{written}>{inside}</{name}>")


def _escaped(value: object) -> str:
    """Escaped, without control characters and marks that reorder a line, which HTML cannot escape."""
    return escape(clean(value, allowed="\n\N{NO-BREAK SPACE}"))
