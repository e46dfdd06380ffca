"""Where specs differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any, Final

from ..records.run_records import flatten


class Missing(Enum):
    """The value of a key that a mapping lacks, which differs from null."""

    MISSING = "-"


MISSING: Final = Missing.MISSING


def differences(mappings: Sequence[Mapping[str, Any]]) -> dict[str, tuple[Any, ...]]:
    """Key path -> each mapping's value, for values that are not all equal; keys are grouped by their first part.

    Args:
        mappings: nested, e.g. resolved specs. A list is one value.
    """
    flat = [dict(flatten(spec)) for spec in mappings]
    paths = dict.fromkeys(path for settings in flat for path in settings)
    parts = list(dict.fromkeys(path.split(".")[0] for path in paths))
    found = {}
    for path in sorted(paths, key=lambda path: parts.index(path.split(".")[0])):
        values = tuple(settings.get(path, MISSING) for settings in flat)
        if any(value != values[0] for value in values):
            found[path] = values
    return found
