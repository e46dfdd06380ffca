"""The words, signs and quoted texts that a filter consists of."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NoReturn

from ...errors import UsageError

_TOKEN = re.compile(
    r"""\s*(?:(?P<text>"(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*')|(?P<sign>[(),\[\]]|!=|<=|>=|[=<>~])"""
    r"""|(?P<word>[^\s()\[\],=<>~!"']+))"""
)
_NUMBER = re.compile(r"[+-]?(?:\d[\d_]*\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


def refuse(what: str, column: int, hint: str) -> NoReturn:
    """Raise a UsageError that names the column of a filter, from 1."""
    raise UsageError(what, where=f"filter, column {column}", hint=hint)


@dataclass(frozen=True)
class Token:
    """`kind`: text (in quotes), word, sign or end; `column` is where it stands, from 1."""

    kind: str
    text: str
    column: int


def tokens(text: str) -> Iterator[Token]:
    """The tokens of a filter. Raises UsageError at what is none."""
    place, end = 0, len(text.rstrip())
    while place < end:
        found = _TOKEN.match(text, place)
        if found is None or found.lastgroup is None:
            column = place + len(text[place:]) - len(text[place:].lstrip())
            refuse(f"{text[column]!r} cannot be read", column + 1, 'texts stand in "quotes" that are closed')
        kind = found.lastgroup
        yield Token(kind, found[kind], found.start(kind) + 1)
        place = found.end()


def unquoted(token: Token) -> str:
    """The text itself: without quotes and backslashes."""
    return re.sub(r"\\(.)", r"\1", token.text[1:-1]) if token.kind == "text" else token.text


def number(text: str) -> float | int | str:
    """The number that a word is, or the word."""
    if not _NUMBER.fullmatch(text):
        return text
    plain = text.replace("_", "")
    digits = plain.lstrip("+-")
    # A float where it could be one: Python refuses to read integers of thousands of digits.
    return int(plain) if digits.isdigit() and len(digits) < 1000 else float(plain)
