"""Filters over runs: `task=pick_place and agent.learning_rate<1e-3 and not state in (failed, lost)`.

    filter     = all ("or" all)*
    all        = one ("and" one)*
    one        = "not" one | "(" filter ")" | key operator value | key "in" "(" value ("," value)* ")"
    operator   = "=" | "!=" | "<" | "<=" | ">" | ">=" | "~"
    value      = number | true | false | null | word | "text in quotes"

A comparison with a value that a run does not have is false, except that with `= null`; `!=` is `not =`. `~` says that
a text contains another, in upper or lower case. Of the tags any may fit. Numbers are compared as numbers, texts as
texts (times are ISO 8601, which sorts like time), one with the other never. Nothing is evaluated but this.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from operator import ge, gt, le, lt
from typing import Any, NoReturn, Protocol

from .errors import UsageError

LONGEST = 10_000
"""Characters of a filter."""
DEEPEST = 50
"""Levels of parentheses and nots: far below what Python's stack holds."""
_OPERATORS = "= != < <= > >= ~ in"
_TOKEN = re.compile(
    r"""\s*(?:(?P<text>"(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*')|(?P<sign>[(),\[\]]|!=|<=|>=|[=<>~])"""
    r"""|(?P<word>[^\s()\[\],=<>~!"']+))"""
)
_NUMBER = re.compile(r"[+-]?(?:\d[\d_]*\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_WORDS: dict[str, bool | None] = {"true": True, "false": False, "null": None, "none": None}
_ORDER: dict[str, Callable[[Any, Any], bool]] = {"<": lt, "<=": le, ">": gt, ">=": ge}


@dataclass(frozen=True)
class Literal:
    """A value as it was written, and what it may mean beside that text."""

    text: str
    value: float | int | bool | str | None

    def equals(self, actual: Any) -> bool:
        if isinstance(actual, str):
            return actual == self.text  # an id may consist of digits
        if isinstance(actual, bool) or isinstance(self.value, bool):
            return actual is self.value
        return bool(actual == self.value)


class Node(Protocol):
    """A part of a filter."""

    def matches(self, values: Mapping[str, Any]) -> bool: ...

    def comparisons(self) -> Iterator[Comparison]: ...


@dataclass(frozen=True)
class Comparison:
    """`key operator literals`; `column` is where the key stands, from 1."""

    key: str
    operator: str
    literals: tuple[Literal, ...]
    column: int

    def matches(self, values: Mapping[str, Any]) -> bool:
        actual = values.get(self.key)
        if self.operator == "!=":
            return not self._any(actual, Literal.equals)
        if self.operator in {"=", "in"}:
            return self._any(actual, Literal.equals)
        return self._any(actual, self._contains if self.operator == "~" else self._ordered)

    def comparisons(self) -> Iterator[Comparison]:
        yield self

    def _any(self, actual: Any, fits: Callable[[Literal, Any], bool]) -> bool:
        if isinstance(actual, list | tuple) and self.key == "tags":
            return any(fits(literal, entry) for literal in self.literals for entry in actual)
        plain = json.dumps(actual) if isinstance(actual, list | tuple | dict) else actual
        return any(fits(literal, plain) for literal in self.literals)

    @staticmethod
    def _contains(literal: Literal, actual: Any) -> bool:
        if actual is None:
            return False
        text = actual if isinstance(actual, str) else json.dumps(actual)
        return literal.text.casefold() in text.casefold()

    def _ordered(self, literal: Literal, actual: Any) -> bool:
        order = _ORDER[self.operator]
        if isinstance(actual, str):
            return order(actual, literal.text)
        if actual is None or isinstance(actual, bool) or not isinstance(literal.value, int | float):
            return False
        return order(actual, literal.value)


@dataclass(frozen=True)
class All:
    """Every part matches."""

    parts: tuple[Node, ...]

    def matches(self, values: Mapping[str, Any]) -> bool:
        return all(part.matches(values) for part in self.parts)

    def comparisons(self) -> Iterator[Comparison]:
        for part in self.parts:
            yield from part.comparisons()


@dataclass(frozen=True)
class Either:
    """Some part matches."""

    parts: tuple[Node, ...]

    def matches(self, values: Mapping[str, Any]) -> bool:
        return any(part.matches(values) for part in self.parts)

    def comparisons(self) -> Iterator[Comparison]:
        for part in self.parts:
            yield from part.comparisons()


@dataclass(frozen=True)
class Not:
    """The part does not match."""

    part: Node

    def matches(self, values: Mapping[str, Any]) -> bool:
        return not self.part.matches(values)

    def comparisons(self) -> Iterator[Comparison]:
        yield from self.part.comparisons()


@dataclass(frozen=True)
class Filter:
    """A parsed filter."""

    text: str
    root: Node

    @property
    def keys(self) -> frozenset[str]:
        return frozenset(comparison.key for comparison in self.root.comparisons())

    def matches(self, values: Mapping[str, Any]) -> bool:
        """Whether a run with these values by key fits; keys that are missing are null."""
        return self.root.matches(values)

    def refuse_unknown(self, known: Callable[[str], bool], closest: Callable[[str], str | None]) -> None:
        """Raise a UsageError at the first key that is not known.

        Args:
            known: whether a key is one.
            closest: the key that one is most like, if any.
        """
        for comparison in self.root.comparisons():
            if not known(comparison.key):
                like = closest(comparison.key)
                _fail(
                    f"no run has {comparison.key!r}",
                    comparison.column,
                    f"did you mean {like}?" if like else "`karolos runs show RUN` shows what there is",
                )


def parse(text: str) -> Filter:
    """Read a filter.

    Raises:
        UsageError: it cannot be read; says in which column, from 1, and what is allowed there.
    """
    if len(text) > LONGEST:
        raise UsageError(f"the filter has {len(text):,} characters", hint=f"up to {LONGEST:,} are read")
    return Filter(text, _Parser(text).read())


def _fail(what: str, column: int, hint: str) -> NoReturn:
    raise UsageError(what, where=f"filter, column {column}", hint=hint)


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    column: int


class _Parser:
    """Recursive descent over the tokens of a filter."""

    def __init__(self, text: str) -> None:
        self._tokens = [*_tokens(text), _Token("end", "", len(text.rstrip()) + 1)]
        self._at = 0
        self._depth = 0

    def read(self) -> Node:
        node = self._either()
        if self._next.kind != "end":
            _fail(f"{self._next.text!r} does not belong here", self._next.column, "go on with and, or; or end")
        return node

    @property
    def _next(self) -> _Token:
        return self._tokens[self._at]

    def _take(self) -> _Token:
        self._at += 1
        return self._tokens[self._at - 1]

    def _takes(self, word: str) -> bool:
        token = self._next
        found = token.kind != "text" and token.text.lower() == word
        self._at += found
        return found

    def _either(self) -> Node:
        parts = [self._all()]
        while self._takes("or"):
            parts.append(self._all())
        return parts[0] if len(parts) == 1 else Either(tuple(parts))

    def _all(self) -> Node:
        parts = [self._one()]
        while self._takes("and"):
            parts.append(self._one())
        return parts[0] if len(parts) == 1 else All(tuple(parts))

    def _one(self) -> Node:
        self._depth += 1
        if self._depth > DEEPEST:
            _fail("too many levels", self._next.column, f"up to {DEEPEST} parentheses and nots may lie in each other")
        if self._takes("not"):
            node: Node = Not(self._one())
        elif self._takes("("):
            node = self._either()
            self._expect(")")
        else:
            node = self._comparison()
        self._depth -= 1
        return node

    def _comparison(self) -> Node:
        key = self._take()
        if key.kind not in {"word", "text"} or (key.kind == "word" and key.text.lower() in {"and", "or", "in"}):
            _fail(f"{key.text or 'the end'!r} is no key", key.column, "e.g. task=reach, or agent.learning_rate<1e-3")
        name = _unquoted(key)
        if self._takes("in"):
            return Comparison(name, "in", self._list(), key.column)
        if self._next.text.lower() == "not" and self._tokens[self._at + 1].text.lower() == "in":
            self._at += 2
            return Not(Comparison(name, "in", self._list(), key.column))
        operator = self._take()
        if operator.kind != "sign" or operator.text not in _OPERATORS.split():
            _fail(f"{operator.text or 'the end'!r} is no comparison", operator.column, f"there are {_OPERATORS}")
        return Comparison(name, operator.text, (self._literal(),), key.column)

    def _list(self) -> tuple[Literal, ...]:
        end = "]" if self._takes("[") else ")"
        if end == ")":
            self._expect("(")
        literals = [self._literal()]
        while self._takes(","):
            literals.append(self._literal())
        self._expect(end)
        return tuple(literals)

    def _literal(self) -> Literal:
        token = self._take()
        if token.kind == "text":
            return Literal(_unquoted(token), _unquoted(token))
        if token.kind != "word":
            _fail(f"{token.text or 'the end'!r} is no value", token.column, 'a number, a word or a "text in quotes"')
        if token.text.lower() in _WORDS:
            return Literal(token.text, _WORDS[token.text.lower()])
        return Literal(token.text, _number(token.text))

    def _expect(self, sign: str) -> None:
        if not self._takes(sign):
            _fail(f"a {sign} is missing", self._next.column, f"before {self._next.text or 'the end'!r}")


def _tokens(text: str) -> Iterator[_Token]:
    place, end = 0, len(text.rstrip())
    while place < end:
        found = _TOKEN.match(text, place)
        if found is None or found.lastgroup is None:
            column = place + len(text[place:]) - len(text[place:].lstrip())
            _fail(f"{text[column]!r} cannot be read", column + 1, 'texts stand in "quotes" that are closed')
        kind = found.lastgroup
        yield _Token(kind, found[kind], found.start(kind) + 1)
        place = found.end()


def _unquoted(token: _Token) -> str:
    return re.sub(r"\\(.)", r"\1", token.text[1:-1]) if token.kind == "text" else token.text


def _number(text: str) -> float | int | str:
    if not _NUMBER.fullmatch(text):
        return text
    plain = text.replace("_", "")
    digits = plain.lstrip("+-")
    # A float where it could be one: Python refuses to read integers of thousands of digits.
    return int(plain) if digits.isdigit() and len(digits) < 1000 else float(plain)
