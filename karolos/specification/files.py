"""Reads spec files and merges them with the files that they extend."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import Problem, UsageError
from ..files import SPECS
from ..registry import closest
from .merge import merged, normalised
from .nodes import Mark, Node, refuse, shown, variable_problems
from .yaml_text import MAX_CHARACTERS, BrokenTextError, read

SHIPPED = "karolos:"
"""Beginning of the names of the specs that ship with karolos, e.g. karolos:bases/sac_grasp.yaml."""
SPEC_SUFFIXES = (".yaml", ".yml")


def shipped_specs() -> dict[str, Path]:
    """The specs that ship with karolos, by their names without suffix, e.g. panda_reach and bases/sac_grasp."""
    return {path.relative_to(SPECS).with_suffix("").as_posix(): path for path in sorted(SPECS.glob("**/*.yaml"))}


def find_spec(given: str | Path) -> tuple[Path, str]:
    """The file that is meant, and its name in positions.

    A file of this name comes first. Without one, panda_reach or panda_reach.yaml means the shipped spec of that name;
    karolos:panda_reach always does. The file of an unknown name is missing, which reading it reports.
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

    Raises:
        UsageError: there is no such spec.
    """
    path, source = find_spec(f"{SHIPPED}{name.removeprefix(SHIPPED)}")
    if not path.exists():
        hint = "`karolos spec list` shows them"
        near = closest(name, shipped_specs())
        raise UsageError(f"no spec {name!r} ships with karolos", hint=f"did you mean {near}? {hint}" if near else hint)
    text = path.read_text("utf-8")
    lines = text.splitlines(keepends=True)
    extends = (read(text, source)[0] or Node({}, Mark(source))).get("extends")
    for target in reversed(list(extends.walk()) if extends else []):
        if isinstance(target.value, str):
            row, column = target.at.line - 1, target.at.column - 1
            rest = lines[row][column:].replace(target.value, beside(source, target.value), 1)
            lines[row] = lines[row][:column] + rest
    return "".join(lines)


@dataclass
class SpecFiles:
    """Reads a spec file and the files that it extends, each file once.

    Args:
        root: the spec file, or the name of a shipped spec.
    """

    root: str | Path
    problems: list[Problem] = field(default_factory=list)
    """Problems after which reading can continue."""
    broken: list[Problem] = field(default_factory=list)
    """Problems that leave parts of the spec unknown, so that further checks would mislead."""
    text: str = ""
    """The text of the root file."""
    count: int = 0
    _done: dict[str, Node] = field(default_factory=dict)
    """The trees that are read, by the files' real paths."""

    def load(self) -> Node:
        """The merged tree of nodes without shorthand. Collects problems; raises those of the root file.

        Raises:
            SpecError: the root file cannot be read.
        """
        path, name = find_spec(self.root)
        if wrong := unreadable(path):
            refuse([Problem(Mark(name), "", *wrong)])
        try:
            return self._load(path, name, ())
        except BrokenTextError as broken:
            refuse([*self.problems, *self.broken, broken.problem])
            raise

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
            raise BrokenTextError(Problem(start, "", "the file is empty", "give at least robot, task and agent"))
        if node.mapping is None:
            raise BrokenTextError(
                Problem(node.at, "", "a spec is a mapping of keys to values", "begin with `robot: NAME`")
            )
        entries = dict(node.mapping)
        extends = entries.pop("extends", None)
        tree = normalised(Node(entries, start))
        for target in reversed(self._targets(extends)):
            base = self._base(target, Path(file), name, (*above, file))
            tree = merged(base, tree) if base else tree
        self._done[file] = tree
        return tree

    def _targets(self, extends: Node | None) -> list[Node]:
        if extends is None or extends.value is None:
            return []
        targets = extends.items if extends.items is not None else [extends]
        for target in targets:
            if not isinstance(target.value, str) or not target.value:
                what = "should be a path, or a list of paths, relative to this file"
                self.broken.append(Problem(target.at, "extends", what))
        return [target for target in targets if isinstance(target.value, str) and target.value]

    def _base(self, target: Node, path: Path, name: str, above: tuple[str, ...]) -> Node | None:
        """The tree of a file that `path` extends; None after recording a problem."""
        given = target.value
        if given.startswith(SHIPPED):
            base, name = find_spec(given)
        else:
            base, name = path.parent / given, beside(name, given)
        if found := list(variable_problems(target, ("extends",))):
            self.broken += found
            return None
        if wrong := unreadable(base):
            self.broken.append(Problem(target.at, "extends", f"{shown(given)}: {wrong[0]}", wrong[1]))
            return None
        file = os.path.realpath(base)
        if file in above:
            chain = " -> ".join(shown(os.path.basename(one)) for one in (*above[above.index(file) :], file))
            self.broken.append(Problem(target.at, "extends", f"is a circle: {chain}", "remove one of them"))
            return None
        try:
            return self._load(base, name, above)
        except BrokenTextError as broken:
            self.broken.append(broken.problem)
            return None


def beside(name: str, given: str) -> str:
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
    """A hint at a file beside `path`, or at a shipped spec, with a similar name."""
    beside = {Path(name).stem: name for name in _specs_in(path.parent)}  # the suffixes alone would be similar enough
    near = beside.get(closest(path.stem, beside) or "")
    if near is None and (shipped := closest(path.stem, shipped_specs())):
        near = f"{SHIPPED}{shipped}"
    return f"did you mean {shown(near)}?" if near else None if path.suffix else "`karolos spec list` shows what ships"


def _text(path: Path, mark: Mark) -> str:
    try:
        with path.open("rb") as file:
            data = file.read(4 * MAX_CHARACTERS + 1)
        if len(data) > 4 * MAX_CHARACTERS:
            raise BrokenTextError(Problem(mark, "", f"longer than {MAX_CHARACTERS // 1024} kB"))
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        at = Mark(mark.source, data[: error.start].count(b"\n") + 1, rank=mark.rank)
        raise BrokenTextError(Problem(at, "", "is not UTF-8 text", "save the file in UTF-8")) from None
    except OSError as error:
        raise BrokenTextError(Problem(mark, "", f"cannot be read: {error.strerror or error}")) from None
