"""Values from JSON, checked by pydantic against types and the fields of dataclasses."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from pydantic import TypeAdapter, ValidationError

_T = TypeVar("_T")


def from_json(kind: type[_T], value: bytes | Mapping[str, Any]) -> _T | None:
    """The value of a type in a JSON object or its text; None if it is missing, or a number or text is invalid."""
    adapter: TypeAdapter[_T] = _adapter(cast("Any", kind))
    try:
        return adapter.validate_json(value) if isinstance(value, bytes) else adapter.validate_python(value)
    except ValidationError:
        return None


def read_json(kind: type[_T], path: Path) -> _T | None:
    """The value of a type in a file; also None if the file cannot be read."""
    try:
        return from_json(kind, path.read_bytes())
    except OSError:
        return None


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)
