"""Merging of trees of nodes, and parsing of overrides into trees."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ..errors import Problem
from ..registry import loaded
from .nodes import Mark, Node, from_plain, refuse, shown
from .yaml_text import BrokenTextError, read

PARTS = {
    "robot": "robots",
    "task": "tasks",
    "environment": "environments",
    "agent": "agents",
    "buffer": "buffers",
    "orchestrator": "orchestrators",
    "launcher": "launchers",
}
"""Keys of a spec that hold a part, and their kinds of plugins."""
DEFAULT_PLUGINS = {"environment": "robot_task", "buffer": "uniform", "orchestrator": "local"}
"""The plugins of parts that a spec may leave out; `robot_task` needs a robot and a task."""
RANDOMIZATION = "randomization"
SWEEP = "sweep"
TRANSFER = "transfer"


def is_part(path: tuple[str, ...]) -> bool:
    """Whether this path of a spec holds a part."""
    return (len(path) == 1 and path[0] in PARTS) or (len(path) == 2 and path[0] == RANDOMIZATION)


def normalised(node: Node, path: tuple[str, ...] = ()) -> Node:
    """The tree without shorthand: `robot: ur5` becomes `robot: {name: ur5}`, a number a distribution of this value."""
    if is_part(path):
        if isinstance(node.value, str):
            return Node({"name": node.with_key(node.key)}, node.at, node.key)
        if path[0] == RANDOMIZATION and isinstance(node.value, int | float) and not isinstance(node.value, bool):
            values = Node([Node(node.value, node.at)], node.at)
            return Node({"name": Node("choice", node.at), "values": values}, node.at, node.key)
        return node
    if node.mapping is not None and (not path or path == (RANDOMIZATION,)):
        entries = {key: normalised(entry, (*path, key)) for key, entry in node.mapping.items()}
        return Node(entries, node.at, node.key)
    return node


def merged(below: Node, above: Node, path: tuple[str, ...] = ()) -> Node:
    """Merge `above` into `below`, mapping by mapping; other values are replaced.

    A part with another name replaces the whole part, because plugins have different settings. (For overrides that only
    change the name see `with_shared_settings`.) A parameter of a search space is replaced as a whole.
    """
    if below.mapping is None or above.mapping is None:
        return above
    is_parameter = len(path) == 3 and path[:2] == (SWEEP, "space")
    if (is_part(path) and _changes_name(below, above)) or is_parameter:
        return above
    entries = dict(below.mapping)
    for key, entry in above.mapping.items():
        entries[key] = merged(entries[key], entry, (*path, key)) if key in entries else entry
    return Node(entries, above.at, above.key)


def _changes_name(below: Node, above: Node) -> bool:
    old, new = below.get("name"), above.get("name")
    return old is not None and new is not None and old.value != new.value


def override_trees(overrides: Iterable[str], rank: int, problems: list[Problem]) -> list[Node]:
    """Each `path.to.key=value` as a tree to merge into the spec. Appends invalid overrides to `problems`."""
    trees = []
    for place, text in enumerate(overrides):
        mark = Mark(f"override {shown(text)}", rank=rank + place)
        try:
            trees.append(_override(text, mark, problems))
        except BrokenTextError as broken:
            problems.append(broken.problem)
    return trees


def parse_settings(overrides: Iterable[str]) -> dict[str, Any]:
    """Overrides `path.to.key=value` as one dictionary. Raises SpecError."""
    problems: list[Problem] = []
    tree = Node({}, Mark("settings"))
    for override in override_trees(overrides, 0, problems):
        tree = merged(tree, override)
    refuse(problems)
    settings: dict[str, Any] = tree.plain()
    return settings


def _override(text: str, mark: Mark, problems: list[Problem]) -> Node:
    key, equals, value = text.partition("=")
    if not equals:
        raise BrokenTextError(Problem(mark, "", "has no =", "write path.to.key=value, e.g. agent.learning_rate=1e-4"))
    if not all(path := segments(key.strip())):
        raise BrokenTextError(Problem(mark, "", f"{shown(key)!r} is not a path of keys", "write path.to.key=value"))
    if path[0] == "extends":
        raise BrokenTextError(Problem(mark, "extends", "cannot be overridden", "put it into the spec file"))
    try:
        node, value_problems = read(value, mark.source, mark.rank)
    except BrokenTextError as broken:
        raise BrokenTextError(_in_value(broken.problem, key)) from None
    problems.extend(_in_value(problem, key) for problem in value_problems)
    if node is None and value.strip():
        raise BrokenTextError(Problem(mark, key, "the value is a comment", "put it in quotes: key='\"#...\"'"))
    return nested(key.strip(), from_plain(node and node.plain(), mark))


def nested(key: str, value: Node) -> Node:
    """The tree for merging that contains the value at a dotted path."""
    tree = value
    for step in reversed(segments(key)):
        tree = Node({step: tree}, value.at, value.key)
    return normalised(tree)


def _in_value(problem: Problem, key: str) -> Problem:
    """The problem with its column counted in the whole override instead of the value."""
    mark = problem.where
    column = f"column {len(key) + 1 + mark.column}: " if mark.line == 1 else ""
    return Problem(Mark(mark.source, rank=mark.rank), "", f"{column}{problem.what}", problem.hint)


def segments(key: str) -> list[str]:
    """The keys of a dotted path. Keys of `randomization` (task.gravity), `sweep.space` and `transfer` contain dots."""
    path = key.split(".")
    if path[0] == RANDOMIZATION and len(path) > 2:
        path[1:3] = [".".join(path[1:3])]
    if path[:2] == [SWEEP, "space"] and len(path) > 3:
        path[2:] = [".".join(path[2:])]
    depth = {"fine_tune": 2, "variants": 3}.get("".join(path[1:2])) if path[0] == TRANSFER else None
    if depth is not None and len(path) > depth:
        path[depth:] = [".".join(path[depth:])]
    return path


def with_shared_settings(tree: Node, override: Node) -> Node:
    """The override; if it only names another plugin, with the settings that both plugins declare with the same type.

    `buffer.name=priority` therefore retains capacity, hindsight and n_step of a uniform buffer. A file that names
    another plugin replaces the whole part instead.
    """
    for key, above in (override.mapping or {}).items():  # one entry
        below = tree.get(key)
        if key not in PARTS or below is None or set(above.mapping or ()) != {"name"} or not _changes_name(below, above):
            continue
        before, after = _types(key, below["name"].value), _types(key, above["name"].value)
        shared = {
            name: node
            for name, node in (below.mapping or {}).items()
            if name in before and name in after and before[name] == after[name]
        }
        return merged(Node({key: Node(shared, above.at)}, override.at), override)
    return override


def _types(key: str, name: object) -> dict[str, object]:
    """The settings of a plugin with their types; empty if it cannot be loaded, which validation reports."""
    plugin = loaded(PARTS[key], name)
    return {field: info.annotation for field, info in plugin.Settings.model_fields.items()} if plugin else {}
