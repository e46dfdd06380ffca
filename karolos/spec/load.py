"""Loads a file or a dictionary into a validated Spec and reports all problems at once."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..errors import PluginError
from ..registry import singular
from .checks import ROBOT_TASK, environment_problems, pairing_problems
from .files import SpecFiles
from .merge import PARTS, RANDOMIZATION, SWEEP, merged, normalised, override_trees, with_shared_settings
from .model import NAME, Spec
from .nodes import DEFAULT, Located, Mark, Node, from_plain, leaves, refuse
from .parts import validate_strictly
from .problems import located_problems
from .space import space_problems, trial_spec


def load_spec(path: str | Path, overrides: Iterable[str] = ()) -> Spec:
    """The spec in a YAML file, merged with the files that it extends and with `path.to.key=value` overrides.

    Raises:
        SpecError: the file is unreadable or invalid; carries every problem found, at file:line:column.
        PluginError: a plugin of the spec is broken.
    """
    files = SpecFiles(Path(path))
    tree = files.load()
    trees = override_trees(overrides, files.count, files.broken)
    if files.broken:
        refuse([*files.problems, *files.broken])
    return _resolve(tree, trees, files.problems, Path(path).stem)


def spec_from_dict(spec: Mapping[str, Any], overrides: Iterable[str] = ()) -> Spec:
    """The spec in a dictionary. Raises as `load_spec` does, with "dict" as the position."""
    mark = Mark("dict")
    if "extends" in spec:
        refuse([Located(mark, "extends", "a dictionary has no file to extend from", "load the file with load_spec")])
    problems: list[Located] = []
    trees = override_trees(overrides, 1, problems)
    refuse(problems)
    return _resolve(normalised(from_plain(spec, mark)), trees, [], None)


def _resolve(tree: Node, overrides: Iterable[Node], problems: list[Located], stem: str | None) -> Spec:
    for override in overrides:
        tree = merged(tree, with_shared_settings(tree, override))
    tree = _with_defaults(_without_nulls(tree), stem)
    problems = [*problems, *environment_problems(tree), *pairing_problems(tree)]
    spec: Spec | None = None
    try:
        spec = validate_strictly(Spec, tree.plain())
    except ValidationError as error:
        problems.extend(located_problems(error, tree))
    except PluginError as error:
        raise _at_part(error, tree) from error.__cause__
    refuse(problems)
    refuse(_sweep_problems(tree, spec, stem))
    assert spec is not None  # no problems: it validated
    spec._origins.update(_origins(spec, tree))
    return spec


def _sweep_problems(tree: Node, spec: Spec | None, stem: str | None) -> list[Located]:
    """The problems of a valid spec's sweep."""
    if spec is None or spec.sweep is None:
        return []
    return space_problems(tree, spec.sweep, lambda probe: _with_defaults(probe, stem))


def spec_of_trial(base: Spec, drawn: Mapping[str, Any], name: str, seeds: tuple[int, ...], source: str) -> Spec:
    """The spec of one trial of a sweep. Arguments as those of `trial_spec`.

    Raises:
        SpecError: these values are incompatible; reported at `source`.
    """
    return _resolve(trial_spec(base, drawn, name, seeds, source), [], [], None)


def _without_nulls(tree: Node) -> Node:
    """The tree without nulls, so that a spec can remove inherited values."""
    tree = _kept(tree)
    entries = dict(tree.mapping or {})
    if RANDOMIZATION in entries:
        entries[RANDOMIZATION] = _kept(entries[RANDOMIZATION])
    sweep = entries.get(SWEEP)
    if sweep is not None and sweep.mapping is not None and "space" in sweep.mapping:
        entries[SWEEP] = Node({**sweep.mapping, "space": _kept(sweep.mapping["space"])}, sweep.at, sweep.key)
    return Node(entries, tree.at, tree.key)


def _kept(node: Node) -> Node:
    """A mapping without its nulls; anything else as it is."""
    if node.mapping is None:
        return node
    return Node({key: entry for key, entry in node.mapping.items() if entry.value is not None}, node.at, node.key)


def _with_defaults(tree: Node, stem: str | None) -> Node:
    """The tree with a name and the parts that a spec may leave to karolos."""
    given = dict(tree.mapping or {})
    defaults = {"buffer": "uniform", "orchestrator": "local"}
    if "robot" in given and "task" in given:
        defaults["environment"] = ROBOT_TASK
    for key, name in defaults.items():  # below what is given: `buffer: {capacity: 1e5}` needs no name
        default = Node({"name": Node(name, DEFAULT, DEFAULT)}, DEFAULT, DEFAULT)
        given[key] = merged(default, given[key], (key,)) if key in given else default
    if "name" not in given:
        given["name"] = Node(stem if stem is not None else _described(given), DEFAULT, DEFAULT)
        if stem is not None and not re.fullmatch(NAME, stem):
            given["name"] = Node(stem, tree.at, tree.at)
    return Node(given, tree.at, tree.key)


def _described(given: dict[str, Node]) -> str:
    """A name for a spec without a file: what the agent learns in."""
    keys = ("robot", "task") if "robot" in given and "task" in given else ("environment",)
    words = [node.value if (node := given[key].get("name")) else None for key in keys if key in given]
    return "_".join(str(word) for word in words) or "experiment"


def _at_part(error: PluginError, tree: Node) -> PluginError:
    """The error of a broken plugin, told at the first place in the spec that names it."""
    drawn = tree.get(RANDOMIZATION)
    parts = [(key, kind, tree.get(key)) for key, kind in PARTS.items()]
    parts += [
        (f"{RANDOMIZATION}.{key}", "distributions", node) for key, node in ((drawn and drawn.mapping) or {}).items()
    ]
    for key, kind, node in parts:
        name = node.get("name") if node else None
        if name is not None and f"{singular(kind)} {name.value!r} " in f"{error.where} {error.what} ":
            where = f"{name.at}: {key}.name"
            return PluginError(error.what, where=f"{where}: {error.where}" if error.where else where, hint=error.hint)
    return error


def _origins(spec: Spec, tree: Node) -> dict[str, str]:
    """Key path of every resolved value -> where it comes from."""
    return {".".join(path): _origin(tree, path) for path, _ in leaves(spec.dump())}


def _origin(tree: Node, path: tuple[str, ...]) -> str:
    """The place of the value at `path`, or of the scalar that a plugin's settings made it from."""
    node = tree
    for key in path:
        below = node.child(key)
        if below is None:
            return str(DEFAULT if node.mapping is not None else node.at)
        node = below
    return str(node.at)
