"""A spec as a tree of nodes with source positions, and the merging of such trees."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path as FilePath
from typing import Any, TypeAlias

from ..errors import Problem, SpecError, is_secret
from ..registry import loaded
from ..system.files import INSTALLED, file_of

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
ROBOT_TASK = "robot_task"
"""Name of the environment that consists of a robot and a task."""
DEFAULT_PLUGINS = {"environment": ROBOT_TASK, "buffer": "uniform", "orchestrator": "local"}
"""The default plugins of parts. `robot_task` needs a robot and a task."""
RANDOMIZATION = "randomization"
SWEEP = "sweep"
TRANSFER = "transfer"
REMOVABLE = ((), (RANDOMIZATION,), (SWEEP,), (SWEEP, "space"), (TRANSFER,), (TRANSFER, "variants"))
"""Mappings of a spec whose entries null removes. Nulls within a part are settings."""

FILES = {("urdf", "file")}
"""Plugins and their settings that name a file relative to the spec."""

MAX_DEPTH = 32
"""Largest depth of nested mappings and lists. A spec needs six."""

_VARIABLE = re.compile(r"~([A-Za-z_][\w.-]*)?/|([^\s:]*/)?\$([A-Za-z_]\w*|\{\w+\})(/|$)")

Scalar: TypeAlias = bool | int | float | str | None
Path: TypeAlias = tuple[str | int, ...]


@dataclass(frozen=True)
class Mark:
    """A source position: in a file, an override or a dictionary, or a default."""

    source: str
    line: int = 0
    """Line from 1; 0 for a source without lines."""
    column: int = 0
    """Column from 1; 0 for a source without columns."""
    rank: int = 0
    """Index of the source, by which problems are sorted."""

    def __str__(self) -> str:
        parts = [shown(self.source), *(str(number) for number in (self.line, self.column) if number)]
        return ":".join(parts)

    @property
    def order(self) -> tuple[int, int, int]:
        return self.rank, self.line, self.column

    def refusal(self, what: str, hint: str | None = None, *, setting: str = "") -> SpecError:
        """An error with one problem, here."""
        return SpecError([Problem(self, setting, what, hint)])


DEFAULT = Mark("default", rank=1_000_000)


@dataclass(frozen=True)
class Node:
    """A value of a spec: a scalar, a list of nodes, or a mapping from keys to nodes."""

    value: Any
    at: Mark
    key: Mark | None = None
    """Position of this value's key, if it has one."""

    @property
    def mapping(self) -> dict[str, Node] | None:
        return self.value if isinstance(self.value, dict) else None

    @property
    def items(self) -> list[Node] | None:
        return self.value if isinstance(self.value, list) else None

    @property
    def place(self) -> Mark:
        """The position of the whole entry: its key's, otherwise its own."""
        return self.key or self.at

    def with_key(self, key: Mark | None) -> Node:
        return Node(self.value, self.at, key)

    def plain(self) -> Any:
        """The value without marks: dicts, lists and scalars."""
        if self.mapping is not None:
            return {key: node.plain() for key, node in self.mapping.items()}
        if self.items is not None:
            return [node.plain() for node in self.items]
        return self.value

    def get(self, *path: str | int) -> Node | None:
        """The node at a path below this one, or None."""
        node: Node | None = self
        for step in path:
            value = node.value if node else None
            entries = dict(enumerate(value)) if isinstance(value, list) else value
            node = entries.get(step) if isinstance(entries, dict) else None
        return node

    def deepest(self, path: Iterable[str | int]) -> tuple[Node, Path]:
        """The last node on the way along a path, and the path to it. Steps that lead nowhere are skipped."""
        node, found = self, []
        for step in path:
            if (below := node.get(step)) is not None:
                node = below
                found.append(step)
        return node, tuple(found)

    def __getitem__(self, step: str | int) -> Node:
        """The entry `step` of a mapping or a list. Raises KeyError if it is missing."""
        node = self.get(step)
        if node is None:
            raise KeyError(step)
        return node

    def walk(self) -> Iterator[Node]:
        """This node and all nodes below it."""
        yield self
        for node in self.mapping.values() if self.mapping is not None else self.items or ():
            yield from node.walk()

    @property
    def text(self) -> str:
        """The value for messages."""
        if self.mapping is not None:
            return "a mapping"
        if self.items is not None:
            return "a list"
        if self.value is None or isinstance(self.value, bool):
            return {None: "null", True: "true", False: "false"}[self.value]
        return shown(repr(self.value))

    def variable_problems(self, path: Path = ()) -> Iterator[Problem]:
        """A problem for each path that begins with ~ or contains a $VARIABLE. Launcher commands and secrets may."""
        entries = self.mapping.items() if self.mapping is not None else enumerate(self.items or ())
        for key, node in entries:
            if (*path, key) != ("launcher",):
                yield from node.variable_problems((*path, key))
        # a plugin reads a secret from the named variable
        secret = is_secret(next((step for step in reversed(path) if isinstance(step, str)), ""))
        if not secret and isinstance(self.value, str) and _VARIABLE.match(self.value):
            what = f"{shown(self.value)}: ~ and variables are not replaced, so that a spec means the same everywhere"
            yield Problem(self.at, dotted(path), what, "write the path itself; a relative one moves with its project")

    def anchored(self, folder: FilePath) -> Node:
        """The tree with absolute names of the files that parts name relative to `folder`."""
        if self.items is not None:
            return Node([one.anchored(folder) for one in self.items], self.at, self.key)
        if self.mapping is None:
            return self
        plugin = self.get("name")
        entries = {
            key: Node(str(_found(one.value, folder)), one.at, one.key)
            if isinstance(one.value, str) and (key == "robot.file" or (plugin and (plugin.value, key) in FILES))
            else one.anchored(folder)
            for key, one in self.mapping.items()
        }
        return Node(entries, self.at, self.key)

    def normalised(self, path: tuple[str, ...] = ()) -> Node:
        """The tree without shorthand: `robot: ur5` becomes `robot: {name: ur5}`, a number a distribution of it."""
        if is_part(path):
            if isinstance(self.value, str):
                return Node({"name": self}, self.at, self.key)
            if path[0] == RANDOMIZATION and isinstance(self.value, int | float) and not isinstance(self.value, bool):
                values = Node([Node(self.value, self.at)], self.at)
                return Node({"name": Node("choice", self.at), "values": values}, self.at, self.key)
            return self
        if self.mapping is not None and (not path or path == (RANDOMIZATION,)):
            entries = {key: entry.normalised((*path, key)) for key, entry in self.mapping.items()}
            return Node(entries, self.at, self.key)
        return self

    def merged(self, above: Node, path: tuple[str, ...] = ()) -> Node:
        """Merge `above` into this tree, mapping by mapping; other values are replaced.

        A part with another name replaces the whole part, because plugins have different settings. (For changes of only
        the name see `merge`.) A parameter of a search space is replaced as a whole.
        """
        if self.mapping is None or above.mapping is None:
            return above
        is_parameter = len(path) == 3 and path[:2] == (SWEEP, "space")
        if (is_part(path) and _changes_name(self, above)) or is_parameter:
            return above
        entries = dict(self.mapping)
        for key, entry in above.mapping.items():
            entries[key] = entries[key].merged(entry, (*path, key)) if key in entries else entry
        return Node(entries, above.at, above.key)

    def under(self, key: str) -> Node:
        """The tree for merging that contains this value at a dotted path."""
        tree = self
        for step in reversed(segments(key)):
            tree = Node({step: tree}, self.at, self.key)
        return tree.normalised()

    @classmethod
    def of(cls, value: object, mark: Mark) -> Node:
        """A tree of nodes from dicts, lists, tuples and scalars, all with the same mark.

        Raises SpecError for values that a spec cannot contain; carries all of them.
        """
        problems: list[Problem] = []
        node = _from_plain(value, mark, (), problems)
        refuse(problems)
        return node


def refuse(problems: Iterable[Problem]) -> None:
    """Raise a SpecError with all problems, sorted by position, if there are any."""
    ordered = sorted(dict.fromkeys(problems), key=lambda problem: problem.where.order)
    if ordered:
        raise SpecError(ordered)


def shown(text: str) -> str:
    """Text from a spec for messages: escaped if not printable, and shortened."""
    safe = text if text.isprintable() else ascii(text)[1:-1]
    return safe if len(safe) <= 200 else f"{safe[:200]}..."


def dotted(path: Sequence[str | int]) -> str:
    """A path in the notation of messages and overrides: agent.learning_rate, seeds[1]."""
    text = ""
    for step in path:
        text += f"[{step}]" if isinstance(step, int) else f"{'.' if text else ''}{shown(step)}"
    return text


def _from_plain(value: object, mark: Mark, path: Path, problems: list[Problem]) -> Node:
    plain: Any = None
    if len(path) > MAX_DEPTH:
        problems.append(Problem(mark, dotted(path), f"nested deeper than {MAX_DEPTH} levels"))
    elif value is None or isinstance(value, bool | str):
        plain = value
    elif isinstance(value, Real):  # also numpy's numbers
        plain = int(value) if isinstance(value, Integral) else float(value)
    elif isinstance(value, Mapping):
        plain = {}
        for key, entry in value.items():
            if isinstance(key, str):
                plain[key] = _from_plain(entry, mark, (*path, key), problems)
            else:
                problems.append(Problem(mark, dotted(path), f"the key {shown(repr(key))} is not a string"))
    elif isinstance(value, list | tuple):
        plain = [_from_plain(entry, mark, (*path, index), problems) for index, entry in enumerate(value)]
    else:
        what = f"a spec cannot contain a {type(value).__name__}"
        problems.append(Problem(mark, dotted(path), what, "use strings, numbers, lists and dictionaries"))
    return Node(plain, mark, mark)


def leaves(value: object, path: Path = (), *, lists: bool = False) -> Iterator[tuple[tuple[Any, ...], object]]:
    """All leaves of nested dicts with their paths (an empty dict is a leaf); `lists`: also those of nested lists."""
    if lists and isinstance(value, list | tuple):
        value = dict(enumerate(value))
    if isinstance(value, dict) and (value or not path):
        for key, entry in value.items():
            yield from leaves(entry, (*path, key), lists=lists)
    else:
        yield path, value


def _found(name: str, folder: FilePath) -> FilePath:
    """A file by its absolute name. A file of a missing package keeps its name."""
    return file_of(name) if name.startswith(INSTALLED) else folder / name


def is_part(path: tuple[str, ...]) -> bool:
    """Whether this path of a spec holds a part."""
    return (len(path) == 1 and path[0] in PARTS) or (len(path) == 2 and path[0] == RANDOMIZATION)


def _changes_name(below: Node, above: Node) -> bool:
    old, new = below.get("name"), above.get("name")
    return old is not None and new is not None and old.value != new.value


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


def merge(written: Node, changes: Iterable[Node] = (), stem: str | None = None) -> Node:
    """The whole spec: the written tree with changes on top, without nulls, with a name and all default parts.

    A change that names another plugin keeps settings that both plugins declare with the same type, unless it gives
    them: `buffer.name=priority` and `buffer={name: priority, alpha: 0.5}` keep capacity, hindsight and n_step of a
    uniform buffer. A file that names another plugin replaces the whole part. `stem` is the default of the spec's name.
    """
    tree = written
    for change in changes:
        tree = _named(tree, change)
        tree = tree.merged(_with_shared_settings(tree, change))
    entries = dict(_without_nulls(tree).anchored(FilePath.cwd()).mapping or {})
    joined = "robot" in entries and "task" in entries
    for key, name in DEFAULT_PLUGINS.items():
        if joined or name != ROBOT_TASK:  # below what is given: `buffer: {capacity: 1e5}` needs no name
            default = Node({"name": Node(name, DEFAULT, DEFAULT)}, DEFAULT, DEFAULT)
            entries[key] = default.merged(entries[key], (key,)) if key in entries else default
    if "name" not in entries:
        entries["name"] = Node(_described(entries) if stem is None else stem, DEFAULT, DEFAULT)
    return Node(entries, written.at, written.key)


def _named(tree: Node, change: Node) -> Node:
    """The tree; a part without a name has its default name, so that a change can name another plugin."""
    for key, above in (change.mapping or {}).items():  # one entry
        below = tree.get(key)
        if key in DEFAULT_PLUGINS and below is not None and below.mapping is not None and above.get("name") is not None:
            default = Node({"name": Node(DEFAULT_PLUGINS[key], DEFAULT, DEFAULT)}, below.at, below.key)
            return Node({**(tree.mapping or {}), key: default.merged(below)}, tree.at, tree.key)
    return tree


def _with_shared_settings(tree: Node, change: Node) -> Node:
    """The change; if it names another plugin, completed by the settings that both declare."""
    for key, above in (change.mapping or {}).items():  # one entry
        below = tree.get(key)
        if key in PARTS and below is not None and above.mapping is not None and _changes_name(below, above):
            before, after = (_types(key, part["name"].value) for part in (below, above))
            same = {name for name in before if name in after and before[name] == after[name]}
            shared = {name: node for name, node in (below.mapping or {}).items() if name in same - set(above.mapping)}
            return Node({key: Node(shared, above.at)}, change.at).merged(change)
    return change


def _types(key: str, name: object) -> dict[str, object]:
    """The settings of a plugin with their types. Empty if it cannot be loaded; `bind` reports this."""
    plugin = loaded(PARTS[key], name)
    return {field: info.annotation for field, info in plugin.Settings.model_fields.items()} if plugin else {}


def _without_nulls(node: Node, path: tuple[str, ...] = ()) -> Node:
    """The tree without nulls, so that a spec can remove inherited values."""
    if node.mapping is None or path not in REMOVABLE:
        return node
    entries = {
        key: _without_nulls(entry, (*path, key))
        for key, entry in node.mapping.items()
        if entry.value is not None or path == (SWEEP,)
    }
    return Node(entries, node.at, node.key)


def _described(given: Mapping[str, Node]) -> str:
    """A name for a spec without a file: its robot and task, or its environment."""
    keys = ("robot", "task") if "robot" in given and "task" in given else ("environment",)
    words = [node.value if (node := given[key].get("name")) else None for key in keys if key in given]
    return "_".join(str(word) for word in words) or "experiment"
