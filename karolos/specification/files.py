"""Reads spec files and merges them with the files that they extend."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import KarolosError, Problem, SpecError
from ..registry import PluginEntry, closest, find
from .merge import DEFAULT_PLUGINS, PARTS, merged, normalised
from .nodes import Mark, Node, refuse, shown
from .yaml_text import MAX_CHARACTERS, BrokenTextError, read

SPECS_FOLDER = "specs"
"""Name of a project's folder of specs; `extends` cannot refer to files outside it."""
SPEC_SUFFIXES = (".yaml", ".yml")


@dataclass
class SpecFiles:
    """Reads a spec file and the files that it extends, each file once.

    Args:
        root: the spec file; no file outside its folder tree is read.
    """

    root: Path
    problems: list[Problem] = field(default_factory=list)
    """Problems after which reading can continue."""
    broken: list[Problem] = field(default_factory=list)
    """Problems that leave parts of the spec unknown, so that further checks would mislead."""
    count: int = 0
    _done: dict[Path, Node] = field(default_factory=dict)

    def load(self) -> Node:
        """The merged tree of nodes without shorthand. Collects problems; raises those of the root file.

        Raises:
            SpecError: the root file cannot be read.
        """
        shown_name = os.fspath(self.root)
        missing = _unreadable(self.root)
        if missing:
            raise SpecError([Problem(shown(shown_name), "", missing, _similar(self.root))])
        try:
            return self._load(self.root.resolve(), shown_name, ())
        except BrokenTextError as broken:
            refuse([*self.problems, *self.broken, broken.problem])
            raise

    def _load(self, path: Path, name: str, above: tuple[Path, ...]) -> Node:
        if path in self._done:
            return self._done[path]
        rank, self.count = self.count, self.count + 1
        start = Mark(name, 1, 1, rank)
        node, problems = read(_text(path, Mark(name, rank=rank)), name, rank)
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
            base = self._base(target, path, name, (*above, path))
            tree = merged(base, tree) if base else tree
        self._done[path] = tree
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

    def _base(self, target: Node, path: Path, name: str, above: tuple[Path, ...]) -> Node | None:
        """The tree of a file that `path` extends; None after recording a problem."""
        file = (path.parent / target.value.replace("\0", "?")).resolve()
        wrong = self._extends_problem(target.value, file, above)
        if wrong:
            self.broken.append(Problem(target.at, "extends", *wrong))
            return None
        try:
            return self._load(file, os.path.normpath(os.path.join(os.path.dirname(name), target.value)), above)
        except BrokenTextError as broken:
            self.broken.append(broken.problem)
            return None

    def _extends_problem(self, target: str, file: Path, above: tuple[Path, ...]) -> tuple[str, str | None] | None:
        """The problem and hint if a file cannot be extended; otherwise None."""
        tree = spec_tree(self.root)
        if not file.is_relative_to(tree):
            return f"{shown(target)} is outside {shown(os.fspath(tree))}", "extend files of that folder"
        if file in above:
            chain = " -> ".join(shown(one.name) for one in (*above[above.index(file) :], file))
            return f"is a circle: {chain}", "remove one of them"
        missing = _unreadable(file)
        return (f"{shown(target)}: {missing}", _similar(file)) if missing else None


def named_plugins(tree: Node) -> dict[str, PluginEntry]:
    """The plugins that a spec names, by the key of their part; unknown ones are left out. Imports none of them."""
    found = {}
    for key, kind in PARTS.items():
        name = tree.get(key, "name")
        with suppress(KarolosError):
            found[key] = find(kind, DEFAULT_PLUGINS.get(key, "") if name is None else str(name.value))
    return found


def spec_tree(root: Path) -> Path:
    """The folder that limits `extends`: the nearest one named `specs` above the file, or the file's own."""
    folder = root.resolve().parent
    return next((above for above in (folder, *folder.parents) if above.name == SPECS_FOLDER), folder)


def _unreadable(path: Path) -> str | None:
    """The reason why `path` is unreadable, or None. Refuses pipes and devices, because they may never end."""
    try:
        if path.is_dir():
            return "is a folder, not a spec file"
        if not path.exists():
            return "there is no such file"
        return None if path.is_file() else "is not an ordinary file"
    except (OSError, ValueError) as error:
        return f"cannot be read: {getattr(error, 'strerror', None) or error}"


def _similar(path: Path) -> str | None:
    """A hint at specs in the folder `path`, or at a file with a similar name."""
    try:
        folder = path if path.is_dir() else path.parent
        beside = sorted(entry.name for entry in folder.iterdir() if entry.suffix in SPEC_SUFFIXES and entry != path)
    except (OSError, ValueError):
        return None
    if folder == path:
        return f"it contains {shown(', '.join(beside))}" if beside else None
    near = closest(path.name, beside) or closest(path.stem, beside)
    return f"did you mean {shown(near)}?" if near else None


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
