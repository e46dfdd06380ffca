"""A spec as a tree of nodes with source positions, and problems at these positions."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, TypeAlias

from ..errors import Problem, SpecError, is_secret

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
    """From 1; 0 for a source without lines."""
    column: int = 0
    """From 1; 0 for a source without columns."""
    rank: int = 0
    """Index of the source, by which problems are sorted."""

    def __str__(self) -> str:
        parts = [shown(self.source), *(str(number) for number in (self.line, self.column) if number)]
        return ":".join(parts)

    @property
    def order(self) -> tuple[int, int, int]:
        return self.rank, self.line, self.column


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


def from_plain(value: object, mark: Mark) -> Node:
    """A tree of nodes from dicts, lists, tuples and scalars, all with the same mark.

    Raises:
        SpecError: values that a spec cannot contain; carries all of them.
    """
    problems: list[Problem] = []
    node = _from_plain(value, mark, (), problems)
    refuse(problems)
    return node


def _from_plain(value: object, mark: Mark, path: Path, problems: list[Problem]) -> Node:
    plain: Any = None
    if len(path) > MAX_DEPTH:
        problems.append(Problem(mark, dotted(path), f"nested deeper than {MAX_DEPTH} levels"))
    elif value is None or isinstance(value, bool | str):
        plain = value
    elif isinstance(value, Real):  # numpy's numbers as well
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


def leaves(value: object, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], object]]:
    """All values in nested dicts that are not non-empty dicts, with their paths."""
    if isinstance(value, dict) and (value or not path):
        for key, entry in value.items():
            yield from leaves(entry, (*path, key))
    else:
        yield path, value


def variable_problems(tree: Node, path: Path = ()) -> Iterator[Problem]:
    """A problem for each path with ~ or a $VARIABLE. The launcher's commands may have them, and names of secrets."""
    entries = tree.mapping.items() if tree.mapping is not None else enumerate(tree.items or ())
    for key, node in entries:
        if (*path, key) != ("launcher",):
            yield from variable_problems(node, (*path, key))
    secret = is_secret(next((step for step in reversed(path) if isinstance(step, str)), ""))
    if isinstance(tree.value, str) and not secret and _VARIABLE.match(tree.value):
        what = f"{shown(tree.value)}: ~ and variables are not replaced, so that a spec means the same everywhere"
        yield Problem(tree.at, dotted(path), what, "write the path itself; a relative one moves with its project")
