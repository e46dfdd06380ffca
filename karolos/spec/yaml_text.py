"""Conversion between YAML text and nodes. This module alone imports PyYAML.

The reader uses parser events instead of `compose()` to see explicit tags and aliases, and to limit depth and alias
expansion before building nodes. Scalars follow the YAML 1.2 core schema (https://yaml.org/spec/1.2.2, 10.3.2).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NoReturn

import yaml

from ..errors import Problem
from .nodes import MAX_DEPTH, Mark, Node, Scalar, shown

MAX_CHARACTERS = 256 * 1024
"""Largest length of a file. PyYAML reads about 100 kB/s."""
MAX_NODES = 20_000
"""Largest number of values in a file after alias expansion."""
MAX_DIGITS = 400
"""Largest number of digits; more than the largest float has."""

_NULL = re.compile(r"null|Null|NULL|~|")
_BOOL = re.compile(r"true|True|TRUE|false|False|FALSE")
_INT = re.compile(r"[-+]?[0-9]+")
_OCTAL = re.compile(r"0o[0-7]+")
_HEX = re.compile(r"0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITY = re.compile(r"[-+]?\.(inf|Inf|INF)")
_NAN = re.compile(r"\.(nan|NaN|NAN)")


class BrokenTextError(Exception):
    """Reading the text cannot continue; carries the problem and its position."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.what)
        self.problem = problem


def scalar(text: str) -> Scalar:
    """The value of a plain (unquoted) scalar in the YAML 1.2 core schema. Raises ValueError for too many digits."""
    if _NULL.fullmatch(text):
        return None
    if _BOOL.fullmatch(text):
        return text.lower() == "true"
    number = _number(text)
    return text if number is None else number


def _number(text: str) -> int | float | None:
    whole = _INT.fullmatch(text), _OCTAL.fullmatch(text) or _HEX.fullmatch(text)
    if len(text) > MAX_DIGITS and (any(whole) or _FLOAT.fullmatch(text)):
        raise ValueError(f"a number of more than {MAX_DIGITS} digits")
    if any(whole):
        return int(text) if whole[0] else int(text, 0)
    if _FLOAT.fullmatch(text) or _INFINITY.fullmatch(text) or _NAN.fullmatch(text):
        return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
    return None


def read(text: str, source: str, rank: int = 0, *, lines: bool = True) -> tuple[Node | None, list[Problem]]:
    """The document in `text`, and the problems after which reading can continue.

    Args:
        text: one YAML document.
        source: name of the file or override, for positions.
        rank: index of this source, for sorting problems.
        lines: whether positions have line and column, or the source alone.

    Returns:
        The document's node, None for an empty document; and problems with duplicate or invalid keys and with tags.

    Raises:
        BrokenTextError: the text is not YAML, holds several documents, or is too large, deep or repetitive.
    """
    reader = _Reader(source, rank, lines)
    if len(text) > MAX_CHARACTERS:
        raise BrokenTextError(Problem(Mark(source, rank=rank), "", f"longer than {MAX_CHARACTERS // 1024} kB"))
    try:
        events = yaml.parse(text, Loader=yaml.SafeLoader)
        return reader.document(events), reader.problems
    except yaml.MarkedYAMLError as error:
        what = " ".join((error.problem or error.context or "cannot be read").split())
        hint = "indent with spaces" if "'\\t'" in what else None
        mark = error.problem_mark or error.context_mark
        raise BrokenTextError(Problem(reader.place(mark), "", f"not valid YAML: {what}", hint)) from None
    except yaml.reader.ReaderError as error:
        raise BrokenTextError(Problem(reader.offset(text, error), "", f"not valid YAML: {error.reason}")) from None


@dataclass
class _Reader:
    source: str
    rank: int
    lines: bool
    problems: list[Problem] = field(default_factory=list)
    _anchors: dict[str, tuple[Node, int] | None] = field(default_factory=dict)
    """Anchor -> its node and the number of its values; None while reading it."""
    _count: int = 0

    def place(self, mark: Any) -> Mark:
        if mark is None or (not self.lines and mark.line):
            return Mark(self.source, rank=self.rank)
        if not self.lines:
            return Mark(self.source, 0, mark.column + 1, self.rank)
        return Mark(self.source, mark.line + 1, mark.column + 1, self.rank)

    def offset(self, text: str, error: Any) -> Mark:
        before = text[: error.position] if isinstance(error.position, int) else ""
        line, column = before.count("\n") + 1, len(before) - before.rfind("\n")
        return Mark(self.source, line if self.lines else 0, column, self.rank)

    def document(self, events: Iterator[Any]) -> Node | None:
        root: Node | None = None
        seen = False
        for event in events:
            if isinstance(event, yaml.DocumentStartEvent):
                if seen:
                    self._fail(event, "a second document", "a spec is one document; remove `---`")
                seen = True
            elif isinstance(event, yaml.NodeEvent):
                root = self._node(event, events, 0)
                if _is_empty(event):
                    root = None
        return root

    def _node(self, event: Any, events: Iterator[Any], depth: int) -> Node:
        count_before = self._count
        self._add(event, 1)
        if depth > MAX_DEPTH:
            self._fail(event, f"nested deeper than {MAX_DEPTH} levels")
        if isinstance(event, yaml.AliasEvent):
            return self._alias(event)
        if event.anchor:
            self._anchors[event.anchor] = None
        if event.tag and event.tag != "!":  # a lone ! means that the scalar is a string
            self._report(event, f"the tag {shown(event.tag)} is not allowed", "write the plain value")
        if isinstance(event, yaml.ScalarEvent):
            node = self._scalar(event)
        elif isinstance(event, yaml.SequenceStartEvent):
            node = self._list(event, events, depth)
        else:
            node = self._mapping(event, events, depth)
        if event.anchor:
            self._anchors[event.anchor] = (node, self._count - count_before)
        return node

    def _scalar(self, event: Any) -> Node:
        mark = self._mark(event)
        if event.style is not None or event.tag:
            return Node(event.value, mark)
        try:
            return Node(scalar(event.value), mark)
        except ValueError as error:
            self._report(event, str(error))
            return Node(0, mark)

    def _list(self, event: Any, events: Iterator[Any], depth: int) -> Node:
        nodes = []
        while not isinstance(entry := next(events), yaml.SequenceEndEvent):
            nodes.append(self._node(entry, events, depth + 1))
        return Node(nodes, self._mark(event))

    def _mapping(self, event: Any, events: Iterator[Any], depth: int) -> Node:
        entries: dict[str, Node] = {}
        while not isinstance(entry := next(events), yaml.MappingEndEvent):
            key = self._node(entry, events, depth + 1)
            value = self._node(next(events), events, depth + 1)
            mark = self._mark(entry)
            if not isinstance(key.value, str):
                written = shown(repr(key.plain()))
                self._report(entry, f"the key {written} is not a string", "put it in quotes if it is meant as a name")
            elif key.value in entries:
                first = entries[key.value].place
                self._report(entry, f"duplicate key {shown(key.value)!r}, first at {first}", "remove one of them")
            else:
                entries[key.value] = value.with_key(mark)
        return Node(entries, self._mark(event))

    def _alias(self, event: Any) -> Node:
        if event.anchor not in self._anchors:
            self._fail(event, f"no anchor &{shown(event.anchor)} before this alias")
        anchored = self._anchors[event.anchor]
        if anchored is None:
            self._fail(event, f"the alias *{shown(event.anchor)} is inside its own anchor")
        node, count = anchored
        self._add(event, count)
        return node

    def _add(self, event: Any, count: int) -> None:
        self._count += count
        if self._count > MAX_NODES:
            self._fail(event, f"more than {MAX_NODES} values, aliases expanded", "write a spec without them")

    def _mark(self, event: Any) -> Mark:
        return self.place(event.start_mark) if self.lines else Mark(self.source, rank=self.rank)

    def _report(self, event: Any, what: str, hint: str | None = None) -> None:
        self.problems.append(Problem(self.place(event.start_mark), "", what, hint))

    def _fail(self, event: Any, what: str, hint: str | None = None) -> NoReturn:
        raise BrokenTextError(Problem(self.place(event.start_mark), "", what, hint))


def _is_empty(event: Any) -> bool:
    """Whether the event is the null of an empty document."""
    return type(event) is yaml.ScalarEvent and not (event.value or event.style or event.tag or event.anchor)


class _Dumper(yaml.SafeDumper):
    """Quotes every string that YAML 1.1 or 1.2 would read as another type."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002  (the overridden signature)
        return True


_NUMBER_LIKE = re.compile(rf"(?:{_INT.pattern}|{_OCTAL.pattern}|{_HEX.pattern}|{_FLOAT.pattern})$")
_Dumper.add_implicit_resolver("tag:yaml.org,2002:float", _NUMBER_LIKE, list("-+.0123456789"))


def to_yaml(spec: dict[str, Any]) -> str:
    """A resolved spec as YAML that loads as the same spec."""
    text: str = yaml.dump(spec, Dumper=_Dumper, sort_keys=False, default_flow_style=None, allow_unicode=True, width=110)
    return text
