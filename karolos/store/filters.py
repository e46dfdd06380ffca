"""Filters over runs: `task=pick_place and agent.learning_rate<1e-3 and not state in (failed, lost)`.

    filter     = all ("or" all)*
    all        = one ("and" one)*
    one        = "not" one | "(" filter ")" | key operator value | key "in" "(" value ("," value)* ")"
    operator   = "=" | "==" | "!=" | "<" | "<=" | ">" | ">=" | "~"
    value      = number | true | false | null | word | "text in quotes"

A comparison with a missing value is false, except `= null`. `!=` means `not =`. `~` means that a text contains another,
in upper or lower case. A comparison of `tags` is true if it is true for any tag. Numbers are compared only with
numbers, texts only with texts, and times only with times (ISO 8601, in UTC if there is no zone). Python parses the
text, but never evaluates it as code.
"""

from __future__ import annotations

import ast
import json
import re
from bisect import bisect_right
from collections.abc import Callable, Container, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import accumulate
from operator import ge, gt, le, lt
from typing import Any

from ..errors import UsageError, alternatives
from ..records.run_records import STATES, timestamp

EXAMPLE = "e.g. task=reach and agent.learning_rate<1e-3"
LONGEST = 10_000
"""Largest number of characters of a filter."""
TIMES = ("created", "updated")
"""Keys whose values are times."""
DEEPEST = 50
"""Largest number of nested ands, ors and nots; far below Python's stack limit."""
_OPERATORS: dict[Any, str] = dict(
    zip(
        (ast.Eq, ast.NotEq, ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Is, ast.In),
        ("=", "!=", "<", "<=", ">", ">=", "~", "in"),
        strict=True,
    )
)
_ORDER: dict[str, Callable[[Any, Any], bool]] = {"<": lt, "<=": le, ">": gt, ">=": ge}
_PYTHON = {"=": "==", "~": "is", "and": "and", "or": "or", "not": "not", "in": "in"}
"""Texts that Python's parser sees for signs and words. For keys and values it sees a name."""
_WORDS: dict[str, bool | None] = {"true": True, "false": False, "null": None, "none": None}
_TOKEN = re.compile(
    r"""\s*(?:(?P<text>"(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*')|(?P<sign>[(),\[\]]|!=|<=|>=|==|[=<>~])"""
    r"""|(?P<word>[^\s()\[\],=<>~!"']+))""",
    re.DOTALL,
)

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

    def refuse_texts(self, numbers: Container[str]) -> None:
        """Raise a UsageError if a key in `numbers`, whose value is a number in each run, is compared with a text."""
        for comparison in self.comparisons:
            if comparison.key in numbers and comparison.operator != "~":
                for literal in comparison.literals:
                    if isinstance(literal.value, str):
                        what = f"{literal.text!r} is not a number, as {comparison.key} is"
                        raise _error(what, literal.column, f"e.g. {comparison.key}>1000")

    def refuse_unknown(self, known: Callable[[str], bool], closest: Callable[[str], str | None]) -> None:
        """Raise a UsageError at the first key that is not `known`, with the `closest`, or at an unknown state."""
        for comparison in self.comparisons:
            if not known(comparison.key):
                like = closest(comparison.key)
                hint = f"did you mean {like}?" if like else "`karolos runs show RUN` shows the keys"
                raise _error(f"no run has {comparison.key!r}", comparison.column, hint)
            if comparison.key == "state" and comparison.operator in {"=", "!=", "in"}:
                for literal in comparison.literals:
                    if literal.value is not None and literal.text not in STATES:
                        hint = alternatives(literal.text, STATES, what="states")
                        raise _error(f"{literal.text!r} is not a state", comparison.column, hint)


@dataclass(frozen=True)
class Token:
    """A key, a value, a word or a sign of a filter."""

    text: str
    """Text as written, without quotes."""
    value: float | int | bool | str | None
    """Its possible meaning as a number, boolean or null."""
    column: int
    """Column, from 1."""
    python: str
    """Text that Python's parser sees for it."""

    def equals(self, actual: Any) -> bool:
        if isinstance(actual, str):
            return actual == self.text  # an id may consist of digits
        if isinstance(actual, list | tuple | dict):
            with suppress(ValueError):
                return bool(json.loads(self.text) == json.loads(json.dumps(actual)))
            return False
        if isinstance(actual, bool) or isinstance(self.value, bool):
            return actual is self.value
        return bool(actual == self.value)


@dataclass(frozen=True)
class FilterComparison:
    """`key operator literals`; `column` is the position of the key, from 1."""

    key: str
    operator: str
    literals: tuple[Token, ...]
    column: int

    def matches(self, values: Mapping[str, Any]) -> bool:
        actual = values.get(self.key)
        if self.key == "tags" and isinstance(actual, list | tuple):
            found = any(self._holds(literal, tag) for literal in self.literals for tag in actual)
        else:
            found = any(self._holds(literal, actual) for literal in self.literals)
        return found != (self.operator == "!=")

    def _holds(self, literal: Token, actual: Any) -> bool:
        """Whether one value has this relation to a literal; that of `!=` is `=`."""
        if self.operator in {"=", "!=", "in"}:
            return literal.equals(actual)
        if self.operator == "~":
            text = actual if isinstance(actual, str) else "" if actual is None else json.dumps(actual)
            return actual is not None and literal.text.casefold() in text.casefold()
        order = _ORDER[self.operator]
        if isinstance(actual, str):
            return order(actual, literal.text)
        if isinstance(actual, bool) or not all(isinstance(one, int | float) for one in (actual, literal.value)):
            return False
        return order(actual, literal.value)


def parse(text: str) -> Filter:
    """Read a filter. Raises UsageError with the column, from 1, and what is allowed there, if it cannot be read."""
    if len(text) > LONGEST:
        raise UsageError(f"the filter has {len(text):,} characters", hint=f"up to {LONGEST:,} are read")
    if not (tokens := list(_tokens(text))):
        raise _error("the filter is empty", 1, EXAMPLE)
    return _Parser([*tokens, Token("", None, len(text.rstrip()) + 1, "")]).read()


class _Parser:
    """Builds conditions from the tree of Python's parser. Nodes that no filter needs are refused."""

    def __init__(self, tokens: list[Token]) -> None:
        self._tokens = tokens
        self._starts = list(accumulate((len(token.python) + 1 for token in tokens[:-1]), initial=0))
        """Place of each token in the text that Python sees."""
        self._comparisons: list[FilterComparison] = []

    def read(self) -> Filter:
        try:
            tree = ast.parse(" ".join(token.python for token in self._tokens), mode="eval")
            condition = self._condition(tree.body)
        except SyntaxError as error:
            what = "is never closed" if "never closed" in error.msg else "does not belong here"
            raise self._error(error.offset - 1 if error.offset else self._starts[-1], what) from None
        except (MemoryError, RecursionError):
            hint = f"up to {DEEPEST} ands, ors and nots in each other are read"
            raise _error("too many levels", 1, hint) from None
        return Filter(condition, tuple(self._comparisons))

    def _condition(self, node: ast.expr, depth: int = 0) -> Condition:
        if depth == DEEPEST:
            raise RecursionError
        match node:
            case ast.BoolOp(op, operands):
                parts = [self._condition(operand, depth + 1) for operand in operands]
                holds = all if isinstance(op, ast.And) else any
                return lambda values: holds(part(values) for part in parts)
            case ast.UnaryOp(ast.Not(), operand):
                return _negated(self._condition(operand, depth + 1))
            case ast.Compare(ast.Name() as key, [ast.NotIn()], [right]):
                return _negated(self._comparison(key, "in", right))
            case ast.Compare(ast.Name() as key, [op], [right]) if type(op) in _OPERATORS:
                return self._comparison(key, _OPERATORS[type(op)], right)
            case _:
                raise self._error(node.col_offset, "is not the beginning of a comparison")

    def _comparison(self, key: ast.Name, operator: str, right: ast.expr) -> Condition:
        values = right.elts if operator == "in" and isinstance(right, ast.Tuple | ast.List) else [right]
        names = [value for value in values if isinstance(value, ast.Name)]
        if not names or len(names) < len(values):
            raise self._error(right.col_offset, "is not a value", 'a number, a word or a "text in quotes"')
        name, *literals = (self._tokens[int(name.id[1:])] for name in (key, *names))
        if name.text in TIMES and operator != "~":
            literals = [literal if literal.value is None else _time(literal) for literal in literals]
        self._comparisons.append(FilterComparison(name.text, operator, tuple(literals), name.column))
        return self._comparisons[-1].matches

    def _error(self, offset: int, what: str, hint: str = EXAMPLE) -> UsageError:
        """The error at the token at this place in the text that Python sees."""
        token = self._tokens[bisect_right(self._starts, offset) - 1]
        if token is self._tokens[-1]:
            return _error(f"something is missing after {self._tokens[-2].text!r}", token.column, hint)
        return _error(f"{token.text!r} {what}", token.column, hint)


def _negated(condition: Condition) -> Condition:
    return lambda values: not condition(values)


def _tokens(text: str) -> Iterator[Token]:
    position, number = 0, 0
    while position < len(text.rstrip()):
        found = _TOKEN.match(text, position)
        if found is None or found.lastgroup is None:
            column = position + len(text[position:]) - len(text[position:].lstrip())
            raise _error(f"{text[column]!r} cannot be read", column + 1, 'write texts in "quotes" and close them')
        kind, word, column = found.lastgroup, found[found.lastgroup], found.start(found.lastgroup) + 1
        if kind == "text":
            plain = re.sub(r"\\(.)", r"\1", word[1:-1], flags=re.DOTALL)
            yield Token(plain, plain, column, f"_{number}")
        else:
            python = word if kind == "sign" else f"_{number}"
            yield Token(word, _value(word), column, _PYTHON.get(word.lower(), python))
        position, number = found.end(), number + 1


def _value(word: str) -> float | int | bool | str | None:
    """The number, boolean or null that a word means, or the word."""
    for kind in (int, float):
        with suppress(ValueError):  # also for integers of thousands of digits, which become floats
            return kind(word)
    return _WORDS.get(word.lower(), word)


def _time(literal: Token) -> Token:
    """A literal as a time in the form of the records. Raises UsageError if it is none."""
    try:
        read = datetime.fromisoformat(literal.text.removesuffix(" UTC"))
        text = timestamp(read if read.tzinfo else read.replace(tzinfo=UTC))
    except (ValueError, OverflowError):
        hint = 'e.g. created>2026-11-29 or created>"2026-11-29 18:30"; without a zone it is UTC'
        raise _error(f"{literal.text!r} is not a time", literal.column, hint) from None
    return replace(literal, text=text, value=text)


def _error(what: str, column: int, hint: str) -> UsageError:
    return UsageError(what, where=f"filter, column {column}", hint=hint)
