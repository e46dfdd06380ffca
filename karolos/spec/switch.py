"""Naming another plugin on the command line: what both know stays as it was set."""

from __future__ import annotations

from ..errors import PluginError, UsageError
from ..registry import load
from .merge import PARTS
from .nodes import Node


def keeping_what_fits(tree: Node, override: Node) -> Node:
    """The override; where all it does is to name another plugin, with the settings of the old one that the new one has.

    `buffer.name=priority` keeps capacity, hindsight and n_step of a uniform buffer: whoever writes it wants another
    buffer and nothing else changed. A setting fits if both plugins declare it with the same type. A file that names
    another plugin replaces the whole part.
    """
    if override.mapping is None or len(override.mapping) != 1:
        return override
    ((key, above),) = override.mapping.items()
    below = tree.get(key)
    if (
        key not in PARTS
        or below is None
        or below.mapping is None
        or above.mapping is None
        or set(above.mapping) != {"name"}
    ):
        return override
    old, new = below.mapping.get("name"), above.mapping["name"]
    if old is None or old.value == new.value:
        return override
    before, after = _types(key, old.value), _types(key, new.value)
    kept = {
        name: node
        for name, node in below.mapping.items()
        if name in before and name in after and before[name] == after[name]
    }
    return Node({key: Node({**kept, **above.mapping}, above.at, above.key)}, override.at, override.key)


def _types(key: str, name: object) -> dict[str, object]:
    """The settings of a plugin with their types; none where it cannot be loaded, which is told elsewhere."""
    if not isinstance(name, str):
        return {}
    try:
        fields = load(PARTS[key], name).Settings.model_fields
    except (UsageError, PluginError):
        return {}
    return {field: info.annotation for field, info in fields.items()}
