"""Where specs differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any, Final


class Missing(Enum):
    """The value of a key that a mapping lacks, which differs from null."""

    MISSING = "-"


MISSING: Final = Missing.MISSING


def differences(mappings: Sequence[Mapping[str, Any]]) -> dict[str, tuple[Any, ...]]:
    """Key path -> each mapping's value, for values that are not all equal; keys are grouped by their first part.

    A block that a side lacks is one value. So are several keys of a block that a side lacks, as another plugin has.

    Args:
        mappings: nested, e.g. resolved specs. A list is one value.
    """
    found: dict[str, tuple[Any, ...]] = {}
    for key in dict.fromkeys(key for mapping in mappings for key in mapping):
        values = tuple(mapping.get(key, MISSING) for mapping in mappings)
        blocks = [value for value in values if isinstance(value, Mapping)]
        if len(blocks) < len(values):
            found |= {key: values} if any(value != values[0] for value in values) else {}
            continue
        inside = differences(blocks)
        lacking = [name for name in inside if "." not in name and MISSING in inside[name]]
        if len(lacking) > 1:
            own = [{name: block[name] for name in lacking if name in block} or MISSING for block in blocks]
            inside = {"": tuple(own)} | {name: each for name, each in inside.items() if name not in lacking}
        found |= {f"{key}.{name}".rstrip("."): each for name, each in inside.items()}
    return found
