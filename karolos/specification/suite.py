"""Suites: files that name several specs, with settings that hold for all or for one of them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field as Setting
from pydantic import ValidationError

from ..core import Settings
from ..errors import Problem, SpecError
from .files import SHIPPED, SpecFiles, beside, find_spec, unreadable
from .load import load_spec
from .merge import nested
from .model import Name, Spec
from .nodes import Node, refuse, shown
from .parts import validate_strictly
from .problems import located_problems


class SuiteEntry(Settings):
    """One spec of a suite."""

    spec: str = Setting(description="a spec file, relative to the suite's, or the name of one that ships")
    overrides: dict[str, Any] = Setting({}, description="settings of this spec, e.g. training.steps: 1e5")


class SuiteFile(Settings):
    """What a suite file contains. An entry of `specs` may be the spec alone."""

    name: Name = Setting(description="default: the file's name")
    specs: tuple[SuiteEntry, ...] = Setting(min_length=1, description="what is trained")
    overrides: dict[str, Any] = Setting({}, description="settings of all specs, e.g. seeds: [0, 1, 2]")
    measures: tuple[str, ...] = Setting((), description="measures that the report shows; empty: all")


@dataclass(frozen=True)
class Suite:
    """Specs that are trained and reported together. Their names differ."""

    name: str
    specs: tuple[Spec, ...]
    measures: tuple[str, ...] = ()


def is_suite(path: str | Path) -> bool:
    """Whether a file, or the shipped one of this name, names `specs`. False if it cannot be read."""
    try:
        return SpecFiles(path).load().get("specs") is not None
    except SpecError:
        return False


def load_suite(path: str | Path, overrides: Iterable[str] = ()) -> Suite:
    """The suite in a YAML file. `overrides` hold for every spec, above what the suite says.

    Raises:
        SpecError: the suite or a spec is invalid; carries every problem found, at file:line:column.
        PluginError: a plugin of a spec is broken.
    """
    files = SpecFiles(path)
    tree = _written_out(files.load(), find_spec(path)[0].stem)
    keys = (tree.mapping or {}).keys()
    if "specs" not in keys and keys & (Spec.model_fields.keys() - SuiteFile.model_fields.keys()):
        hint = f"`karolos run {shown(str(path))}` trains it"
        refuse([Problem(tree.at, "", "the file is a spec, not a suite", hint)])
    refuse([*files.problems, *files.broken])
    try:
        found: SuiteFile = validate_strictly(SuiteFile, tree.plain())
    except ValidationError as error:
        refuse(located_problems(error, tree, SuiteFile))
        raise
    specs: dict[str, Spec] = {}
    problems: dict[str, Problem] = {}
    for place in range(len(found.specs)):
        entry = tree["specs"][place]
        above = [*_trees(tree.get("overrides")), *_trees(entry.get("overrides"))]
        try:
            spec = load_spec(_file_of(entry["spec"]), overrides, above)
            if spec.name in specs:
                what, hint = f"two specs are called {spec.name}", "give one of them overrides: {name: ...}"
                refuse([Problem(entry.at, f"specs[{place}]", what, hint)])
            specs[spec.name] = spec
        except SpecError as error:
            problems |= {str(problem): problem for problem in error.problems}  # that of all specs is said once
    if problems:
        raise SpecError(list(problems.values()))
    return Suite(found.name, tuple(specs.values()), found.measures)


def _file_of(given: Node) -> str:
    """The spec file that an entry names: beside the suite's, or a shipped one."""
    near = given.value if given.value.startswith(SHIPPED) else beside(given.at.source, given.value)
    name = near if os.path.isfile(find_spec(near)[0]) else given.value
    if wrong := unreadable(find_spec(name)[0]):
        refuse([Problem(given.at, "specs", f"{shown(given.value)}: {wrong[0]}", wrong[1])])
    return str(name)


def _written_out(tree: Node, stem: str) -> Node:
    """The suite's tree with a name, and with entries that are mappings."""
    entries: Mapping[str, Node] = tree.mapping or {}
    specs = entries.get("specs")
    if specs is not None and specs.items is not None:
        each = [Node({"spec": one}, one.at) if isinstance(one.value, str) else one for one in specs.items]
        entries = {**entries, "specs": Node(each, specs.at, specs.key)}
    return Node({"name": Node(stem, tree.at), **entries}, tree.at, tree.key)


def _trees(settings: Node | None) -> list[Node]:
    """Each setting as a tree to merge into a spec."""
    return [nested(key, node) for key, node in ((settings and settings.mapping) or {}).items()]
