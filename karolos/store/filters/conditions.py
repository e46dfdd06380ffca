"""What a filter says of a run: comparisons of its values, joined by and, or and not."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from operator import ge, gt, le, lt
from typing import Any, Protocol

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
