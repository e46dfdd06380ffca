"""Filters over runs: `task=pick_place and agent.learning_rate<1e-3 and not state in (failed, lost)`.

    filter     = all ("or" all)*
    all        = one ("and" one)*
    one        = "not" one | "(" filter ")" | key operator value | key "in" "(" value ("," value)* ")"
    operator   = "=" | "!=" | "<" | "<=" | ">" | ">=" | "~"
    value      = number | true | false | null | word | "text in quotes"

A comparison with a value that a run does not have is false, except `= null`. `!=` means `not =`. `~` means that a text
contains another, in upper or lower case. A comparison of `tags` holds if it holds for any tag. Numbers are compared
with numbers and texts with texts (times are ISO 8601, which sorts like time), never one with the other. Nothing of the
text is evaluated as code.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from operator import ge, gt, le, lt
from typing import Any, NoReturn

from ..errors import UsageError
from ..records.run_records import STATES
from ..registry import alternatives

LONGEST = 10_000
"""Characters of a filter."""
DEEPEST = 50
"""Levels of parentheses and nots; far fewer than Python's stack holds."""
_OPERATORS = ("=", "!=", "<", "<=", ">", ">=", "~", "in")
_ORDER: dict[str, Callable[[Any, Any], bool]] = {"<": lt, "<=": le, ">": gt, ">=": ge}
_WORDS: dict[str, bool | None] = {"true": True, "false": False, "null": None, "none": None}
_TOKEN = re.compile(
    r"""\s*(?:(?P<text>"(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*')|(?P<sign>[(),\[\]]|!=|<=|>=|[=<>~])"""
    r"""|(?P<word>[^\s()\[\],=<>~!"']+))"""
)
_NUMBER = re.compile(r"[+-]?(?:\d[\d_]*\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


Condition = Callable[[Mapping[str, Any]], bool]
"""Whether a run with these values by key matches; missing keys are null."""


@dataclass(frozen=True)
class Filter:
    """A parsed filter: its condition, and the comparisons in it."""

    matches: Condition
    comparisons: tuple[FilterComparison, ...]

    @property
    def keys(self) -> frozenset[str]:
        return frozenset(comparison.key for comparison in self.comparisons)

    def refuse_unknown(self, known: Callable[[str], bool], closest: Callable[[str], str | None]) -> None:
        """Raise a UsageError at the first unknown key, or at a state that does not exist.

        Args:
            known: whether a key is known.
            closest: the known key that is most like a key, if any.
        """
        for comparison in self.comparisons:
            if not known(comparison.key):
                like = closest(comparison.key)
                hint = f"did you mean {like}?" if like else "`karolos runs show RUN` shows the keys"
                _refuse(f"no run has {comparison.key!r}", comparison.column, hint)
            if comparison.key == "state" and comparison.operator in {"=", "!=", "in"}:
                for literal in comparison.literals:
                    if literal.value is not None and literal.text not in STATES:
                        hint = alternatives(literal.text, STATES, what="states")
                        _refuse(f"{literal.text!r} is not a state", comparison.column, hint)


def parse(text: str) -> Filter:
    """Read a filter.

    Raises:
        UsageError: it cannot be read; names the column, from 1, and what is allowed there.
    """
    if len(text) > LONGEST:
        raise UsageError(f"the filter has {len(text):,} characters", hint=f"up to {LONGEST:,} are read")
    return _Parser(text).read()


@dataclass(frozen=True)
class Literal:
    """A value as it was written, and the number, boolean or null it may mean."""

    text: str
    value: float | int | bool | str | None

    def equals(self, actual: Any) -> bool:
        if isinstance(actual, str):
            return actual == self.text  # an id may consist of digits
        if isinstance(actual, bool) or isinstance(self.value, bool):
            return actual is self.value
        return bool(actual == self.value)


@dataclass(frozen=True)
class FilterComparison:
    """`key operator literals`; `column` is the position of the key, from 1."""

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

    def _any(self, actual: Any, holds: Callable[[Literal, Any], bool]) -> bool:
        if isinstance(actual, list | tuple) and self.key == "tags":
            return any(holds(literal, tag) for literal in self.literals for tag in actual)
        plain = json.dumps(actual) if isinstance(actual, list | tuple | dict) else actual
        return any(holds(literal, plain) for literal in self.literals)

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
class _Token:
    """`kind`: text (in quotes), word, sign or end; `column` is its position, from 1."""

    kind: str
    text: str
    column: int

    @property
    def plain(self) -> str:
        """The text without quotes and backslashes."""
        return re.sub(r"\\(.)", r"\1", self.text[1:-1]) if self.kind == "text" else self.text

    @property
    def shown(self) -> str:
        return repr(self.text or "the end")


class _Parser:
    """Recursive descent over the tokens of a filter."""

    def __init__(self, text: str) -> None:
        self._tokens = [*_tokens(text), _Token("end", "", len(text.rstrip()) + 1)]
        self._position = 0
        self._depth = 0
        self._comparisons: list[FilterComparison] = []

    def read(self) -> Filter:
        condition = self._or()
        if self._next.kind != "end":
            _refuse(f"{self._next.shown} does not belong here", self._next.column, "go on with and, or; or end")
        return Filter(condition, tuple(self._comparisons))

    @property
    def _next(self) -> _Token:
        return self._tokens[self._position]

    def _take(self) -> _Token:
        self._position += 1
        return self._tokens[self._position - 1]

    def _accept(self, word: str) -> bool:
        """Take the next token if it is this word or sign."""
        token = self._next
        found = token.kind != "text" and token.text.lower() == word
        self._position += found
        return found

    def _or(self) -> Condition:
        parts = [self._and()]
        while self._accept("or"):
            parts.append(self._and())
        return parts[0] if len(parts) == 1 else lambda values: any(part(values) for part in parts)

    def _and(self) -> Condition:
        parts = [self._one()]
        while self._accept("and"):
            parts.append(self._one())
        return parts[0] if len(parts) == 1 else lambda values: all(part(values) for part in parts)

    def _one(self) -> Condition:
        self._depth += 1
        if self._depth > DEEPEST:
            _refuse("too many levels", self._next.column, f"up to {DEEPEST} nested parentheses and nots are read")
        if self._accept("not"):
            condition = _negated(self._one())
        elif self._accept("("):
            condition = self._or()
            self._expect(")")
        else:
            condition = self._comparison()
        self._depth -= 1
        return condition

    def _comparison(self) -> Condition:
        key = self._take()
        if key.kind not in {"word", "text"} or (key.kind == "word" and key.text.lower() in {"and", "or", "in"}):
            _refuse(f"{key.shown} is not a key", key.column, "e.g. task=reach, or agent.learning_rate<1e-3")
        not_in = self._next.text.lower() == "not" and self._tokens[self._position + 1].text.lower() == "in"
        self._position += not_in
        if self._accept("in"):
            comparison = FilterComparison(key.plain, "in", self._list(), key.column)
        else:
            operator = self._take()
            if operator.kind != "sign" or operator.text not in _OPERATORS:
                _refuse(f"{operator.shown} is not a comparison", operator.column, f"there are {' '.join(_OPERATORS)}")
            comparison = FilterComparison(key.plain, operator.text, (self._literal(),), key.column)
        self._comparisons.append(comparison)
        return _negated(comparison.matches) if not_in else comparison.matches

    def _list(self) -> tuple[Literal, ...]:
        end = "]" if self._accept("[") else ")"
        if end == ")":
            self._expect("(")
        literals = [self._literal()]
        while self._accept(","):
            literals.append(self._literal())
        self._expect(end)
        return tuple(literals)

    def _literal(self) -> Literal:
        token = self._take()
        if token.kind == "text":
            return Literal(token.plain, token.plain)
        if token.kind != "word":
            _refuse(f"{token.shown} is not a value", token.column, 'a number, a word or a "text in quotes"')
        word = token.text.lower()
        return Literal(token.text, _WORDS[word] if word in _WORDS else _number(token.text))

    def _expect(self, sign: str) -> None:
        if not self._accept(sign):
            _refuse(f"a {sign} is missing", self._next.column, f"before {self._next.shown}")


def _negated(condition: Condition) -> Condition:
    return lambda values: not condition(values)


def _tokens(text: str) -> Iterator[_Token]:
    position, end = 0, len(text.rstrip())
    while position < end:
        found = _TOKEN.match(text, position)
        if found is None or found.lastgroup is None:
            column = position + len(text[position:]) - len(text[position:].lstrip())
            _refuse(f"{text[column]!r} cannot be read", column + 1, 'texts stand in "quotes" that are closed')
        yield _Token(found.lastgroup, found[found.lastgroup], found.start(found.lastgroup) + 1)
        position = found.end()


def _number(text: str) -> float | int | str:
    """The number that a word means, or the word."""
    if not _NUMBER.fullmatch(text):
        return text
    plain = text.replace("_", "")
    digits = plain.lstrip("+-")
    # Python refuses to read integers of thousands of digits; such a number becomes a float.
    return int(plain) if digits.isdigit() and len(digits) < 1000 else float(plain)


def _refuse(what: str, column: int, hint: str) -> NoReturn:
    raise UsageError(what, where=f"filter, column {column}", hint=hint)
