"""A spec as a tree of nodes that know where they were written, and problems that point at them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, TypeAlias

from ..errors import Problem, SpecError

MAX_DEPTH = 32
"""Mappings and lists inside one another. A spec needs six."""

Scalar: TypeAlias = bool | int | float | str | None
Path: TypeAlias = tuple[str | int, ...]


@dataclass(frozen=True)
class Mark:
    """Where something was written: a place in a file, an override, a dictionary, or nowhere (a default)."""

    source: str
    line: int = 0
    """From 1; 0 for a source without lines."""
    column: int = 0
    """From 1; 0 for a source without columns."""
    rank: int = 0
    """Place of the source among all sources: problems are told in this order."""

    def __str__(self) -> str:
        parts = [self.source, *(str(number) for number in (self.line, self.column) if number)]
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
    """Where the key of this value stands, when it has one."""

    @property
    def mapping(self) -> dict[str, Node] | None:
        return self.value if isinstance(self.value, dict) else None

    @property
    def items(self) -> list[Node] | None:
        return self.value if isinstance(self.value, list) else None

    @property
    def place(self) -> Mark:
        """Where to point when the whole entry is meant: its key, else itself."""
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
            node = node.child(step) if node else None
        return node

    def child(self, step: str | int) -> Node | None:
        """The entry of a mapping or a list that `step` names, or None."""
        if self.mapping is not None:
            return self.mapping.get(step) if isinstance(step, str) else None
        if self.items is not None and isinstance(step, int) and 0 <= step < len(self.items):
            return self.items[step]
        return None


@dataclass(frozen=True)
class Located:
    """A problem and the place it is told at."""

    mark: Mark
    path: str
    what: str
    hint: str | None = None

    def problem(self) -> Problem:
        return Problem(shown(str(self.mark)), self.path, self.what, self.hint)


def refuse(problems: Iterable[Located]) -> None:
    """Raise a SpecError with every problem, in the order of their places, if there is one."""
    ordered = sorted(dict.fromkeys(problems), key=lambda problem: problem.mark.order)
    if ordered:
        raise SpecError([problem.problem() for problem in ordered])


def shown(text: str) -> str:
    """Text from a spec as it may be printed: whatever is not printable is escaped, and long text is cut."""
    safe = text if text.isprintable() else ascii(text)[1:-1]
    return safe if len(safe) <= 200 else f"{safe[:200]}..."


def dotted(path: Sequence[str | int]) -> str:
    """A path as it is written in messages and overrides: agent.learning_rate, seeds[1]."""
    text = ""
    for step in path:
        text += f"[{step}]" if isinstance(step, int) else f"{'.' if text else ''}{shown(step)}"
    return text


def from_plain(value: object, mark: Mark) -> Node:
    """A tree of nodes from dicts, lists, tuples and scalars, all marked alike.

    Raises:
        SpecError: something in it cannot stand in a spec; every such thing is told.
    """
    problems: list[Located] = []
    node = _from_plain(value, mark, (), problems)
    refuse(problems)
    return node


def _from_plain(value: object, mark: Mark, path: Path, problems: list[Located]) -> Node:
    made: Any = None
    if len(path) > MAX_DEPTH:
        problems.append(Located(mark, dotted(path), f"nested deeper than {MAX_DEPTH} levels"))
    elif value is None or isinstance(value, bool | str):
        made = value
    elif isinstance(value, Real):  # numpy's numbers as well
        made = int(value) if isinstance(value, Integral) else float(value)
    elif isinstance(value, Mapping):
        made = {}
        for key, entry in value.items():
            if isinstance(key, str):
                made[key] = _from_plain(entry, mark, (*path, key), problems)
            else:
                problems.append(Located(mark, dotted(path), f"the key {shown(repr(key))} is not a string"))
    elif isinstance(value, list | tuple):
        made = [_from_plain(entry, mark, (*path, index), problems) for index, entry in enumerate(value)]
    else:
        what = f"a {type(value).__name__} cannot stand in a spec"
        problems.append(Located(mark, dotted(path), what, "use strings, numbers, lists and dictionaries"))
    return Node(made, mark, mark)


def leaves(value: object, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], object]]:
    """Every value below a plain mapping that is not itself a mapping with entries, with its path."""
    if isinstance(value, dict) and (value or not path):
        for key, entry in value.items():
            yield from leaves(entry, (*path, key))
    else:
        yield path, value
