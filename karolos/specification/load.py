"""Loads a file or a dictionary into a validated Spec and reports all problems at once."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..errors import PluginError, Problem
from .files import SpecFiles, find_spec
from .merge import (
    DEFAULT_PLUGINS,
    PARTS,
    RANDOMIZATION,
    SWEEP,
    TRANSFER,
    merged,
    nested,
    normalised,
    override_trees,
    segments,
    with_shared_settings,
)
from .model import NAME_PATTERN, Spec
from .nodes import DEFAULT, Mark, Node, from_plain, leaves, refuse, shown, variable_problems
from .problems import ROBOT_TASK, validate
from .space import application_order, space_problems


def load_spec(path: str | Path, overrides: Iterable[str] = (), above: Iterable[Node] = ()) -> Spec:
    """The spec in a YAML file, merged with the files that it extends and with `path.to.key=value` overrides.

    Args:
        path: of the file, or the name of a shipped spec (`find_spec`).
        overrides: above all else.
        above: settings of a suite, above the file's.

    Raises:
        SpecError: the file is unreadable or invalid; carries every problem found, at file:line:column.
        PluginError: a plugin of the spec is broken.
    """
    files = SpecFiles(path)
    tree = files.load()
    if (specs := tree.get("specs")) is not None:
        hint = f"`karolos suite {shown(str(path))}` trains it"
        refuse([Problem(specs.place, "specs", "the file is a suite, not a spec", hint)])
    trees = override_trees(overrides, files.count, files.broken)
    if files.broken:
        refuse([*files.problems, *files.broken])
    spec = _resolve(tree, [*above, *trees], files.problems, find_spec(path)[0].stem)
    if spec.continued_from is not None:
        what = "only `karolos resume RUN training.steps=...` continues a run; a spec begins one"
        at = next(one["continued_from"].place for one in (*reversed(trees), tree) if one.get("continued_from"))
        refuse([Problem(at, "continued_from", what, "remove it")])
    spec._text = files.text
    return spec


def spec_from_dict(spec: Mapping[str, Any], overrides: Iterable[str] = ()) -> Spec:
    """The spec in a dictionary. Raises as `load_spec` does, with "dict" as the position."""
    mark = Mark("dict")
    if "extends" in spec:
        refuse([Problem(mark, "extends", "a dictionary has no file to extend from", "load the file with load_spec")])
    problems: list[Problem] = []
    trees = override_trees(overrides, 1, problems)
    refuse(problems)
    return _resolve(normalised(from_plain(spec, mark)), trees, [], None)


def _resolve(below: Node, overrides: Sequence[Node], problems: list[Problem], stem: str | None) -> Spec:
    tree = _whole(below, overrides, stem)
    try:
        spec, spec_problems = validate(tree)
    except PluginError as error:
        raise _at_part(error, tree) from None
    refuse([*problems, *variable_problems(tree), *_at_causes(spec_problems, below, overrides, stem)])
    assert spec is not None  # it has no problems
    if spec.sweep is not None:
        refuse(space_problems(tree, spec.sweep, lambda probe: _with_defaults(probe, stem)))
    spec._origins.update({".".join(path): _origin(tree, path) for path, _ in leaves(spec.dump())})
    return spec


def _whole(tree: Node, overrides: Iterable[Node], stem: str | None) -> Node:
    for override in overrides:
        tree = merged(tree, with_shared_settings(tree, override))
    return _with_defaults(_without_nulls(tree), stem)


def _at_causes(problems: list[Problem], tree: Node, overrides: Sequence[Node], stem: str | None) -> list[Problem]:
    """The problems, each at the override without which its setting has none: `agent=ppo` contradicts the spec's buffer.

    A problem stays where it is if that is an override already, or if no single override causes it.
    """
    own = {mark for override in overrides for node in override.walk() for mark in (node.at, node.key)}
    for place, override in enumerate(overrides):
        if all(problem.where in own for problem in problems):
            break
        try:
            others = validate(_whole(tree, [*overrides[:place], *overrides[place + 1 :]], stem))[1]
        except PluginError:  # of a plugin that the override replaces
            continue
        kept = {problem.setting for problem in others}
        problems = [
            one if one.where in own or one.setting in kept else replace(one, where=override.at) for one in problems
        ]
    return problems


def spec_of_trial(base: Spec, drawn: Mapping[str, Any], name: str, seeds: tuple[int, ...], source: str) -> Spec:
    """The spec of one trial of a sweep.

    Args:
        base: the spec that has the sweep.
        drawn: parameter -> number, or label of a choice.
        name: of the trial's runs.
        seeds: on which it is run.
        source: what its settings are marked with, e.g. "trial 7".

    Raises:
        SpecError: these values are incompatible; reported at `source`.
    """
    assert base.sweep is not None  # only such a spec has trials
    mark = Mark(source)
    tree = _with_runs(base, name, seeds, mark)
    for key in application_order(drawn):
        value = nested(key, from_plain(base.sweep.space[key].value(drawn[key]), mark))
        tree = merged(tree, with_shared_settings(tree, value))
    return _resolve(tree, [], [], None)


def spec_of_variant(base: Spec, variant: str, name: str, seeds: tuple[int, ...], *, fine_tune: bool = False) -> Spec:
    """The spec of the runs of one variant of a transfer, changed as overrides would change it.

    Args:
        base: the spec that has the transfer.
        variant: of the transfer.
        name: of the runs.
        seeds: on which it is run.
        fine_tune: whether to change the settings of fine-tuning as well.

    Raises:
        SpecError: the settings are incompatible; reported where they are set.
    """
    transfer = base.transfer
    assert transfer is not None  # only such a spec has variants
    changes = {transfer.place(variant): transfer.settings[variant]}
    if fine_tune:
        changes["transfer.fine_tune"] = transfer.fine_tune
    overrides, origins = [], base.origins
    for place, settings in changes.items():
        for key, value in settings.items():
            mark = Mark(origins.get(f"{place}.{key}", origins.get(place, place)))
            overrides.append(nested(key, from_plain(value, mark)))
    return _resolve(_with_runs(base, name, seeds, Mark(f"variant {variant}")), overrides, [], None)


def spec_without(spec: Spec, setting: str) -> Spec:
    """The spec without a setting, a block or a part that was given: what is left has its default."""
    tree = _removed(from_plain(spec.given(), Mark("dict")), segments(setting))
    found = _resolve(tree, [], [], None)
    found._text = spec.text
    found._origins = {path: spec.origins.get(path, str(DEFAULT)) for path in found.origins}
    return found


def _removed(tree: Node, path: Sequence[str]) -> Node:
    entries = dict(tree.mapping or {})
    if below := entries.pop(path[0], None) if len(path) == 1 else entries.get(path[0]):
        entries |= {path[0]: _removed(below, path[1:])} if len(path) > 1 else {}
    return Node(entries, tree.at, tree.key)


def _with_runs(base: Spec, name: str, seeds: tuple[int, ...], mark: Mark) -> Node:
    """The resolved spec as a tree, with the name and the seeds of other runs.

    Without defaults: where another plugin takes the place of one, those would become its settings.
    """
    return from_plain({**base.alone().given(), "name": name, "seeds": list(seeds)}, mark)


def _without_nulls(node: Node, path: tuple[str, ...] = ()) -> Node:
    """The tree without nulls, so that a spec can remove inherited values. Nulls within a part are settings."""
    removable = ((), (RANDOMIZATION,), (SWEEP,), (SWEEP, "space"), (TRANSFER,), (TRANSFER, "variants"))
    if node.mapping is None or path not in removable:
        return node
    entries = {
        key: _without_nulls(entry, (*path, key))
        for key, entry in node.mapping.items()
        if entry.value is not None or path == (SWEEP,)
    }
    return Node(entries, node.at, node.key)


def _with_defaults(tree: Node, stem: str | None) -> Node:
    """The tree with a name and the parts that a spec may leave to karolos."""
    given = dict(tree.mapping or {})
    joined = "robot" in given and "task" in given
    defaults = {key: name for key, name in DEFAULT_PLUGINS.items() if joined or name != ROBOT_TASK}
    for key, name in defaults.items():  # below what is given: `buffer: {capacity: 1e5}` needs no name
        default = Node({"name": Node(name, DEFAULT, DEFAULT)}, DEFAULT, DEFAULT)
        given[key] = merged(default, given[key], (key,)) if key in given else default
    if "name" not in given:
        given["name"] = Node(stem if stem is not None else _described(given), DEFAULT, DEFAULT)
        if stem is not None and not re.fullmatch(NAME_PATTERN, stem):
            given["name"] = Node(stem, tree.at, tree.at)
    return Node(given, tree.at, tree.key)


def _described(given: dict[str, Node]) -> str:
    """A name for a spec without a file: what the agent learns in."""
    keys = ("robot", "task") if "robot" in given and "task" in given else ("environment",)
    words = [node.value if (node := given[key].get("name")) else None for key in keys if key in given]
    return "_".join(str(word) for word in words) or "experiment"


def _at_part(error: PluginError, tree: Node) -> PluginError:
    """The error of a broken plugin, at the first position in the spec that names it."""
    randomization = tree.get(RANDOMIZATION)
    drawn = (randomization and randomization.mapping) or {}
    kinds = {(key,): kind for key, kind in PARTS.items()} | {(RANDOMIZATION, key): "distributions" for key in drawn}
    for path, kind in kinds.items():
        name = tree.get(*path, "name")
        if name is not None and (kind, name.value) == error.plugin:
            what = f"{error.where}: {error.what}" if error.where else error.what
            setting = f"{'.'.join(path)}.name"
            return PluginError(what, where=str(name.at), setting=setting, plugin=error.plugin, hint=error.hint)
    return error


def _origin(tree: Node, path: tuple[str, ...]) -> str:
    """The place of the value at `path`, or of the scalar that a plugin's settings made it from."""
    node = tree
    for key in path:
        below = node.get(key)
        if below is None:
            return str(DEFAULT if node.mapping is not None else node.at)
        node = below
    return str(node.at)
