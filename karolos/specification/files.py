"""Reads YAML, spec files with the files that they extend, and overrides into trees. Only this module imports PyYAML.

PyYAML composes its nodes; their scalars get values by the YAML 1.2 core schema (https://yaml.org/spec/1.2.2, 10.3.2).
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import yaml

from ..errors import Problem, SpecError, UsageError, closest
from ..system.files import SPECS
from .tree import MAX_DEPTH, Mark, Node, Scalar, refuse, segments, shown

SHIPPED = "karolos:"
"""Prefix of the names of shipped specs, e.g. karolos:bases/sac_grasp.yaml."""
SPEC_SUFFIXES = (".yaml", ".yml")
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
_OVERRIDES = 'write ["training.steps=1000"]'
_PLAIN, _GIVEN = "plain", "given"
"""Tags of nodes without a tag in the text: plain scalars, and all other nodes."""
_AT_HINT = "name a run by its whole id or its folder, not by @last; put other text with @ in quotes"
_HINTS = {"'\\t'": "indent with spaces", "another document": "a spec is one document; remove `---`", "'@'": _AT_HINT}
"""Words of PyYAML's errors -> hint."""


def shipped_specs() -> dict[str, Path]:
    """The shipped specs by their names without suffix, e.g. panda_reach and bases/sac_grasp."""
    return {path.relative_to(SPECS).with_suffix("").as_posix(): path for path in sorted(SPECS.glob("**/*.yaml"))}


def find_spec(given: str | Path) -> tuple[Path, str]:
    """The file that a name means, and its name in positions.

    A file of this name comes first. Without one, panda_reach or panda_reach.yaml means the shipped spec of that name;
    karolos:panda_reach always does. For an unknown name the file is missing, and reading it reports this.
    """
    text = given.as_posix() if isinstance(given, Path) else given
    name = text.removeprefix(SHIPPED).removesuffix(".yaml")
    if text.startswith(SHIPPED) or not os.path.isfile(text):
        found = shipped_specs().get(name)
        if found is not None or text.startswith(SHIPPED):
            return found or SPECS / os.path.basename(name), f"{SHIPPED}{name}.yaml"
    return Path(text), text


def shipped_text(name: str) -> str:
    """The text of a shipped spec with `extends: karolos:NAME`, so that it loads from any folder.

    Raises UsageError if there is no such spec.
    """
    path, source = find_spec(f"{SHIPPED}{name.removeprefix(SHIPPED)}")
    if not path.exists():
        hint = "`karolos spec list` shows them"
        near = closest(name, shipped_specs())
        raise UsageError(f"there is no shipped spec {name!r}", hint=f"did you mean {near}? {hint}" if near else hint)
    text = path.read_text("utf-8")
    lines = text.splitlines(keepends=True)
    extends = (read(text, source)[0] or Node({}, Mark(source))).get("extends")
    for target in reversed(list(extends.walk()) if extends else []):
        if isinstance(target.value, str):
            row, column = target.at.line - 1, target.at.column - 1
            rest = lines[row][column:].replace(target.value, relative_name(source, target.value), 1)
            lines[row] = lines[row][:column] + rest
    return "".join(lines)


@dataclass
class SpecFiles:
    """Reads a spec file, or a shipped spec by its name, and the files that it extends, each file once."""

    root: str | Path
    problems: list[Problem] = field(default_factory=list)
    """Problems after which reading can continue."""
    broken: list[Problem] = field(default_factory=list)
    """Problems that leave parts of the spec unknown. Further checks would then mislead."""
    text: str = ""
    """The text of the root file."""
    count: int = 0
    _done: dict[str, Node] = field(default_factory=dict)
    """The trees of the read files, by their real paths."""

    def load(self) -> Node:
        """The merged tree of nodes without shorthand. Collects problems; raises those of the root file.

        Raises SpecError if the root file cannot be read.
        """
        path, name = find_spec(self.root)
        if wrong := unreadable(path):
            raise Mark(name).refusal(*wrong)
        try:
            return self._load(path, name, ())
        except SpecError as error:
            raise SpecError([*self.problems, *self.broken, *error.problems]) from None

    def _load(self, path: Path, name: str, above: tuple[str, ...]) -> Node:
        file = os.path.realpath(path)
        if file in self._done:
            return self._done[file]
        rank, self.count = self.count, self.count + 1
        start = Mark(name, 1, 1, rank)
        text = _text(path, Mark(name, rank=rank))
        self.text = self.text if above else text
        node, problems = read(text, name, rank)
        self.problems.extend(problems)
        if node is None:
            raise start.refusal("the file is empty", "give at least robot, task and agent")
        if node.mapping is None:
            raise node.at.refusal("a spec is a mapping of keys to values", "begin with `robot: NAME`")
        entries = dict(node.mapping)
        extends = entries.pop("extends", None)
        tree = Node(entries, start).normalised().anchored(Path(file).parent)
        if extends is not None and extends.value is not None:
            for target in reversed([extends] if extends.items is None else extends.items):
                try:
                    tree = self._base(target, Path(file), name, (*above, file)).merged(tree)
                except SpecError as error:
                    self.broken += error.problems
        self._done[file] = tree
        return tree

    def _base(self, target: Node, path: Path, name: str, above: tuple[str, ...]) -> Node:
        """The tree of a file that `path` extends. Raises SpecError."""
        given = target.value
        if not isinstance(given, str) or not given:
            raise target.at.refusal("should be a path, or a list of paths, relative to this file", setting="extends")
        refuse(target.variable_problems(("extends",)))
        shipped = given.startswith(SHIPPED)
        base, name = find_spec(given) if shipped else (path.parent / given, relative_name(name, given))
        if wrong := unreadable(base):
            raise target.at.refusal(f"{shown(given)}: {wrong[0]}", wrong[1], setting="extends")
        if (file := os.path.realpath(base)) in above:
            chain = " -> ".join(shown(os.path.basename(one)) for one in (*above[above.index(file) :], file))
            raise target.at.refusal(f"is a circle: {chain}", "remove one of them", setting="extends")
        return self._load(base, name, above)


def relative_name(name: str, given: str) -> str:
    """The name in positions of a file that the file `name` extends as `given`."""
    prefix = SHIPPED if name.startswith(SHIPPED) else ""
    return prefix + os.path.normpath(os.path.join(os.path.dirname(name.removeprefix(prefix)), given))


def unreadable(path: Path) -> tuple[str, str | None] | None:
    """The reason why `path` is unreadable and a hint, or None. Refuses pipes and devices: they may never end."""
    try:
        mode = os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError, ValueError):  # a ValueError: no file can have this name
        return "there is no such file", _similar(path)
    except OSError as error:
        return f"cannot be read: {error.strerror or error}", None
    if stat.S_ISDIR(mode):
        names = ", ".join(_specs_in(path))
        return "is a folder, not a spec file", f"it contains {shown(names)}" if names else None
    return None if stat.S_ISREG(mode) else ("is not an ordinary file", None)


def _specs_in(folder: Path) -> list[str]:
    try:
        return sorted(entry.name for entry in folder.iterdir() if entry.suffix in SPEC_SUFFIXES)
    except (OSError, ValueError):
        return []


def _similar(path: Path) -> str | None:
    """A hint at a file next to `path`, or at a shipped spec, with a similar name."""
    siblings = {Path(name).stem: name for name in _specs_in(path.parent)}  # equal suffixes are no hint
    near = siblings.get(closest(path.stem, siblings) or "")
    if near is None and (shipped := closest(path.stem, shipped_specs())):
        near = f"{SHIPPED}{shipped}"
    return (
        f"did you mean {shown(near)}?"
        if near
        else None
        if path.suffix
        else "`karolos spec list` lists the shipped ones"
    )


def _text(path: Path, mark: Mark) -> str:
    try:
        with path.open("rb") as file:
            data = file.read(4 * MAX_CHARACTERS + 1)
        if len(data) > 4 * MAX_CHARACTERS:
            raise mark.refusal(f"longer than {MAX_CHARACTERS // 1024} kB")
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        at = Mark(mark.source, data[: error.start].count(b"\n") + 1, rank=mark.rank)
        raise at.refusal("is not UTF-8 text", "save the file in UTF-8") from None
    except OSError as error:
        raise mark.refusal(f"cannot be read: {error.strerror or error}") from None


def override_trees(overrides: Iterable[str], rank: int, problems: list[Problem]) -> list[Node]:
    """Each `path.to.key=value` as a tree to merge into the spec. Appends invalid overrides to `problems`.

    Raises UsageError if they are not in a list, or not texts.
    """
    if isinstance(overrides, str | Mapping):
        raise UsageError("overrides are a list of texts", hint=_OVERRIDES)
    trees = []
    for place, text in enumerate(overrides):
        if not isinstance(text, str):
            raise UsageError(f"an override is a text, not {type(text).__name__}", hint=_OVERRIDES)
        mark = Mark(f"override {shown(text)}", rank=rank + place)
        try:
            trees.append(_override(text, mark))
        except SpecError as error:
            problems += error.problems
    return trees


def parse_settings(overrides: Iterable[str]) -> dict[str, Any]:
    """Overrides `path.to.key=value` as one dictionary. Raises SpecError."""
    problems: list[Problem] = []
    tree = Node({}, Mark("settings"))
    for override in override_trees(overrides, 0, problems):
        tree = tree.merged(override)
    refuse(problems)
    settings: dict[str, Any] = tree.plain()
    return settings


def _override(text: str, mark: Mark) -> Node:
    key, equals, value = text.partition("=")
    if not equals:
        raise mark.refusal("has no =", "write path.to.key=value, e.g. agent.learning_rate=1e-4")
    if not all(path := segments(key.strip())):
        raise mark.refusal(f"{shown(key)!r} is not a path of keys", "write path.to.key=value")
    if path[0] == "extends":
        raise mark.refusal("cannot be overridden", "put it into the spec file", setting="extends")
    try:
        node, problems = read(value, mark.source, mark.rank)
        refuse(problems)
    except SpecError as error:
        raise SpecError([_in_value(problem, key) for problem in error.problems]) from None
    if node is None and value.strip():
        raise mark.refusal("the value is a comment", "put it in quotes: key='\"#...\"'", setting=key)
    return Node.of(node and node.plain(), mark).under(key.strip())


def _in_value(problem: Problem, key: str) -> Problem:
    """The problem with its column counted in the whole override instead of the value."""
    mark = problem.where
    column = f"column {len(key) + 1 + mark.column}: " if mark.line == 1 else ""
    return Problem(Mark(mark.source, rank=mark.rank), "", f"{column}{problem.what}", problem.hint)


def scalar(text: str) -> Scalar:
    """The value of a plain (unquoted) scalar in the YAML 1.2 core schema. Raises ValueError for too many digits."""
    for pattern, convert in _CORE_SCHEMA:
        if pattern.fullmatch(text):
            return convert(text)
    return text


def read(text: str, source: str, rank: int = 0) -> tuple[Node | None, list[Problem]]:
    """The document's node (None for an empty one), and the problems after which reading can continue.

    These are duplicate or invalid keys, and tags. `source` names the file or override in positions; `rank` sorts
    the sources.

    Raises SpecError if the text is not YAML, holds several documents, or is too large, deep or repetitive.
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
        raise self._place(mark).refusal(what, hint)

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
            elif key.value == "<<":
                hint = "write its keys here, or put them into a file and name that in `extends`"
                self._report(written, "YAML's merge << is not read", hint)
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
    """Composes nodes, whose tags say whether the text has one. Refuses a depth beyond Python's recursion limit."""

    def __init__(self, text: str, reader: _YamlReader) -> None:
        super().__init__(text)
        self._reader, self._depth = reader, 0

    def resolve(self, kind: Any, value: Any, implicit: Any) -> str:  # noqa: ARG002 (the overridden signature)
        return _PLAIN if kind is yaml.ScalarNode and implicit[0] else _GIVEN

    def scan_to_next_token(self) -> None:
        """Also skips tabs where YAML allows them: between tokens, and in lines without any. None may indent."""
        scanner: Any = super()
        text: Any = self
        scanner.scan_to_next_token()
        while text.peek() == "\t" and (self.flow_level or not self.allow_simple_key or self._only_blanks()):
            text.forward()
            scanner.scan_to_next_token()

    def _only_blanks(self) -> bool:
        """Whether the rest of the line is empty, or a comment."""
        text: Any = self
        end = next(place for place in count() if text.peek(place) not in " \t")
        return text.peek(end) in "\0\r\n#"

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
    return yaml.dump(spec, Dumper=_Dumper, sort_keys=False, default_flow_style=None, allow_unicode=True, width=110)
