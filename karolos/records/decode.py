"""Frozen dataclasses from JSON objects, by the types of their fields."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from types import UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

_T = TypeVar("_T")


def from_json(kind: type[_T], row: Mapping[str, Any]) -> _T | None:
    """The dataclass in a JSON object; None if a value is invalid or a field without default is missing."""
    try:
        value: _T = _decode(kind, row)
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError):
        return None
    return value


def _decode(kind: Any, row: Mapping[str, Any]) -> Any:
    return kind(**{name: convert(row[name]) for name, convert, required in _fields(kind) if required or name in row})


@cache
def _fields(kind: Any) -> list[tuple[str, Callable[[Any], Any], bool]]:
    """Name, converter and whether it must be there, of each field."""
    hints = get_type_hints(kind)
    return [(one.name, _converter(hints[one.name]), one.default is MISSING) for one in fields(kind)]


def _converter(hint: Any) -> Callable[[Any], Any]:
    """Converts a JSON value to this type. Raises ValueError or TypeError for another value."""
    origin, arguments = get_origin(hint), get_args(hint)
    if hint is Any:
        return lambda value: value
    if origin is Literal:
        return lambda value: arguments[arguments.index(value)]
    if origin is UnionType:  # of a type and None
        given = _converter(arguments[0])
        return lambda value: None if value is None else given(value)
    if origin is tuple:
        item = _converter(arguments[0])
        return lambda value: tuple(map(item, value))
    if origin is Mapping:
        key, content = map(_converter, arguments)
        return lambda value: {key(name): content(one) for name, one in value.items()}
    return (lambda value: _decode(hint, value)) if is_dataclass(hint) else hint
