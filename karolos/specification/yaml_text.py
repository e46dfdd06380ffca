"""Conversion between YAML text and nodes. This module alone imports PyYAML.

PyYAML composes its nodes; their scalars get values by the YAML 1.2 core schema (https://yaml.org/spec/1.2.2, 10.3.2).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, NoReturn

import yaml

from ..errors import Problem
from .nodes import MAX_DEPTH, Mark, Node, Scalar, shown

MAX_CHARACTERS = 256 * 1024
"""Largest length of a file. PyYAML reads about 100 kB/s."""
MAX_NODES = 20_000
"""Largest number of values in a file after alias expansion."""

_CORE_SCHEMA: tuple[tuple[re.Pattern[str], Callable[[str], Scalar]], ...] = (
    (re.compile(r"null|Null|NULL|~|"), lambda _: None),
    (re.compile(r"true|True|TRUE|false|False|FALSE"), lambda text: text.lower() == "true"),
    (re.compile(r"[-+]?[0-9]+"), int),
    (re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+"), lambda text: int(text, 0)),
    (re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"), float),
    (re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"), lambda text: float(text.replace(".", ""))),
)
_PLAIN, _GIVEN = "plain", "given"
"""Tags of nodes without a tag in the text: scalars without quotes, and all others."""
_AT_HINT = "name a run by its whole id or its folder, not by @last; put other text with @ in quotes"
_HINTS = {"'\\t'": "indent with spaces", "another document": "a spec is one document; remove `---`", "'@'": _AT_HINT}
"""Words of PyYAML's errors -> what to do."""


class BrokenTextError(Exception):
    """Reading the text cannot continue; carries the problem and its position."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.what)
        self.problem = problem


def scalar(text: str) -> Scalar:
    """The value of a plain (unquoted) scalar in the YAML 1.2 core schema. Raises ValueError for too many digits."""
    for pattern, convert in _CORE_SCHEMA:
        if pattern.fullmatch(text):
            return convert(text)
    return text


def read(text: str, source: str, rank: int = 0) -> tuple[Node | None, list[Problem]]:
    """The document in `text`, and the problems after which reading can continue.

    Args:
        text: one YAML document.
        source: name of the file or override, for positions.
        rank: index of this source, for sorting problems.

    Returns:
        The document's node, None for an empty document; and problems with duplicate or invalid keys and with tags.

    Raises:
        BrokenTextError: the text is not YAML, holds several documents, or is too large, deep or repetitive.
    """
    reader = _YamlReader(source, rank)
    if len(text) > MAX_CHARACTERS:
        reader.fail(None, f"longer than {MAX_CHARACTERS // 1024} kB")
    try:
        root = _Loader(text, reader).get_single_node()
        return None if root is None else reader.node(root, 0), reader.problems
    except yaml.MarkedYAMLError as error:
        what = " ".join((error.problem or error.context or "cannot be read").split()).removeprefix("but ")
        hint = next((hint for words, hint in _HINTS.items() if words in what), None)
        reader.fail(error.problem_mark or error.context_mark, f"not valid YAML: {what}", hint)
    except yaml.reader.ReaderError as error:
        before = text[: error.position]
        mark = SimpleNamespace(line=before.count("\n"), column=len(before) - before.rfind("\n") - 1)
        reader.fail(mark, f"not valid YAML: {error.reason}")


@dataclass
class _YamlReader:
    """Converts PyYAML's nodes and marks."""

    source: str
    rank: int
    problems: list[Problem] = field(default_factory=list)
    _count: int = 0

    def fail(self, mark: Any, what: str, hint: str | None = None) -> NoReturn:
        raise BrokenTextError(Problem(self._place(mark), "", what, hint))

    def node(self, found: Any, depth: int) -> Node:
        self._count += 1
        if self._count > MAX_NODES:
            what = f"more than {MAX_NODES} values, aliases expanded"
            self.fail(found.start_mark, what, "write a spec without them")
        self.check_depth(found.start_mark, depth)
        if found.tag not in (_PLAIN, _GIVEN):
            self._report(found, f"the tag {shown(found.tag)} is not allowed", "write the plain value")
        value: Any
        if isinstance(found, yaml.MappingNode):
            value = self._mapping(found, depth + 1)
        elif isinstance(found, yaml.SequenceNode):
            value = [self.node(entry, depth + 1) for entry in found.value]
        else:
            value = self._scalar(found) if found.tag == _PLAIN else found.value
        return Node(value, self._place(found.start_mark))

    def check_depth(self, mark: Any, depth: int) -> None:
        if depth > MAX_DEPTH:
            self.fail(mark, f"nested deeper than {MAX_DEPTH} levels")

    def _scalar(self, found: Any) -> Scalar:
        try:
            return scalar(found.value)
        except ValueError:
            self._report(found, "a number of too many digits")
            return 0

    def _mapping(self, found: Any, depth: int) -> dict[str, Node]:
        entries: dict[str, Node] = {}
        for written, entry in found.value:
            key, value = self.node(written, depth), self.node(entry, depth)
            if not isinstance(key.value, str):
                what = f"the key {shown(repr(key.plain()))} is not a string"
                self._report(written, what, "put it in quotes if it is meant as a name")
            elif key.value in entries:
                first = entries[key.value].place
                self._report(written, f"duplicate key {shown(key.value)!r}, first at {first}", "remove one of them")
            else:
                entries[key.value] = value.with_key(self._place(written.start_mark))
        return entries

    def _place(self, mark: Any) -> Mark:
        line, column = (0, 0) if mark is None else (mark.line + 1, mark.column + 1)
        return Mark(self.source, line, column, self.rank)

    def _report(self, found: Any, what: str, hint: str | None = None) -> None:
        self.problems.append(Problem(self._place(found.start_mark), "", what, hint))


class _Loader(yaml.SafeLoader):
    """Composes nodes, whose tags say whether the text has one, and refuses depth before Python's recursion ends."""

    def __init__(self, text: str, reader: _YamlReader) -> None:
        super().__init__(text)
        self._reader, self._depth = reader, 0

    def resolve(self, kind: Any, value: Any, implicit: Any) -> str:  # noqa: ARG002 (the overridden signature)
        return _PLAIN if kind is yaml.ScalarNode and implicit[0] else _GIVEN

    def descend_resolver(self, *_: Any) -> None:
        mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
        self._reader.check_depth(mark, self._depth)
        self._depth += 1

    def ascend_resolver(self) -> None:
        self._depth -= 1


class _Dumper(yaml.SafeDumper):
    """Quotes every string that YAML 1.1 or 1.2 would read as another type."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002  (the overridden signature)
        return True


_NUMBER_LIKE = re.compile(rf"(?:{'|'.join(pattern.pattern for pattern, _ in _CORE_SCHEMA[2:5])})$")
_Dumper.add_implicit_resolver("tag:yaml.org,2002:float", _NUMBER_LIKE, list("-+.0123456789"))


def to_yaml(spec: dict[str, Any]) -> str:
    """A resolved spec as YAML that loads as the same spec."""
    text: str = yaml.dump(spec, Dumper=_Dumper, sort_keys=False, default_flow_style=None, allow_unicode=True, width=110)
    return text
