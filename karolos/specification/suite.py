"""Suites: files that list several specs, with settings for all or for one of them."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import Field as Setting
from pydantic import ValidationError

from ..core import Settings
from ..errors import KarolosError, Problem, SpecError
from .bind import Invalid, explain
from .files import SHIPPED, SpecFiles, find_spec, relative_name, unreadable
from .load import load_spec
from .model import Name, Spec
from .parts import validate_strictly
from .tree import Node, refuse, shown


class SuiteEntry(Settings):
    """One spec of a suite."""

    spec: str = Setting(description="spec: a path relative to the suite's file, or the name of a shipped spec")
    overrides: dict[str, Any] = Setting({}, description="settings of this spec, e.g. training.steps: 1e5")


class SuiteFile(Settings):
    """The content of a suite file. An entry of `specs` may be only the spec."""

    name: Name = Setting(description="name of the suite. Default: the file's name")
    specs: tuple[SuiteEntry, ...] = Setting(min_length=1, description="the specs to train")
    overrides: dict[str, Any] = Setting({}, description="settings of all specs, e.g. seeds: [0, 1, 2]")
    measures: tuple[str, ...] = Setting((), description="measures that the report shows; empty: all")


@dataclass(frozen=True)
class Suite:
    """Specs that are trained and reported together. Their names differ."""

    name: str
    specs: tuple[Spec, ...]
    measures: tuple[str, ...] = ()
    written: Mapping[str, Spec] = field(default_factory=dict)
    """The specs without the overrides, by name."""
    refused: Mapping[str, KarolosError] = field(default_factory=dict)
    """Names of specs that cannot run with the overrides -> why."""

    @property
    def notes(self) -> tuple[str, ...]:
        """One line for each setting or spec that is left out because of the overrides."""
        dropped = defaultdict[str, list[str]](list)
        for spec in self.specs:
            if lost := ", ".join(_lost(self.written[spec.name].given(), spec.given())):
                dropped[lost].append(spec.name)
        lines = [f"{', '.join(names)}: without {lost}" for lost, names in dropped.items()]
        return (*lines, *(f"{name} is left out: {why}" for name, why in self.refused.items()))


def _lost(before: Mapping[str, Any], now: Mapping[str, Any], path: str = "") -> Iterator[str]:
    for key, value in before.items():
        if key not in now:
            yield path + key
        elif isinstance(value, Mapping) and isinstance(now[key], Mapping):
            yield from _lost(value, now[key], f"{path}{key}.")


def is_suite(path: str | Path) -> bool:
    """Whether a file, or the shipped file of this name, has the key `specs`. False if it cannot be read."""
    try:
        return SpecFiles(path).load().get("specs") is not None
    except SpecError:
        return False


def load_suite(path: str | Path, overrides: Iterable[str] = ()) -> Suite:
    """The suite in a YAML file. `overrides` change every spec, and replace settings of the suite.

    An agent that needs the other kind of buffer gets `on_policy` or `uniform`, unless an override names a buffer. A
    spec that an override makes invalid is `refused`, if another spec is valid. Raises as `load_spec`.
    """
    files = SpecFiles(path)
    tree = _written_out(files.load(), find_spec(path)[0].stem)
    keys = (tree.mapping or {}).keys()
    if "specs" not in keys and keys & (Spec.model_fields.keys() - SuiteFile.model_fields.keys()):
        hint = f"`karolos run {shown(str(path))}` trains it"
        raise tree.at.refusal("the file is a spec, not a suite", hint)
    refuse([*files.problems, *files.broken])
    try:
        found: SuiteFile = validate_strictly(SuiteFile, tree.plain())
    except ValidationError as error:
        refuse(explain([Invalid((), SuiteFile, error)], tree, {}))
        raise
    specs, written, refused = dict[str, Spec](), dict[str, Spec](), dict[str, SpecError]()
    problems: dict[str, Problem] = {}
    overrides = list(overrides)
    for place in range(len(found.specs)):
        entry = tree["specs"][place]
        above = [*_trees(tree.get("overrides")), *_trees(entry.get("overrides"))]
        try:
            file = _file_of(entry["spec"])
            spec = plain = load_spec(file, (), above)
            try:
                spec = _overridden(file, overrides, above) if overrides else plain
            except SpecError as error:
                refused[plain.name] = error
            if spec.name in specs:
                what, hint = f"two specs are called {spec.name}", "give one of them overrides: {name: ...}"
                refuse([Problem(entry.at, f"specs[{place}]", what, hint)])
            specs[spec.name], written[spec.name] = spec, plain
        except SpecError as error:
            problems |= {str(problem): problem for problem in error.problems}
    specs = {name: spec for name, spec in specs.items() if name not in refused}
    if problems or not specs:
        problems |= {str(problem): problem for each in refused.values() for problem in each.problems}  # of all: once
        raise SpecError(list(problems.values()))
    return Suite(found.name, tuple(specs.values()), found.measures, written, refused)


def _file_of(given: Node) -> str:
    """The file of a spec, named relative to the suite's file or as a shipped one. Raises SpecError if there is none."""
    near = given.value if given.value.startswith(SHIPPED) else relative_name(given.at.source, given.value)
    file = str(near if os.path.isfile(find_spec(near)[0]) else given.value)
    if wrong := unreadable(find_spec(file)[0]):
        raise given.at.refusal(f"{shown(given.value)}: {wrong[0]}", wrong[1], setting="specs")
    return file


def _overridden(file: str, overrides: list[str], above: list[Node]) -> Spec:
    try:
        return load_spec(file, overrides, above)
    except SpecError as error:
        if any(problem.setting == "buffer" for problem in error.problems):
            for name in () if any(one.startswith("buffer") for one in overrides) else ("on_policy", "uniform"):
                with suppress(SpecError):
                    return load_spec(file, [*overrides, f"buffer={name}"], above)
        raise


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
    return [node.under(key) for key, node in ((settings and settings.mapping) or {}).items()]
