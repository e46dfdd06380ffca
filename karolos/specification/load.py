"""Loads a spec: reads, merges, binds plugins, validates, explains. All problems are reported at once.

Only the settings of a part with an unknown plugin are not checked.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..errors import PluginError, Problem, UsageError
from .bind import bind, explain, validate
from .files import SpecFiles, find_spec, override_trees
from .model import Spec
from .sweep import application_order, space_problems
from .tree import DEFAULT, SWEEP, Mark, Node, leaves, merge, refuse, segments, shown


def load_spec(path: str | Path | Mapping[str, Any], overrides: Iterable[str] = (), above: Iterable[Node] = ()) -> Spec:
    """The spec in a YAML file, merged with the files that it extends and with `path.to.key=value` overrides.

    Args:
        path: of the file, the name of a shipped spec (`find_spec`), or a dictionary as for `spec_from_dict`.
        overrides: have the highest priority.
        above: settings of a suite; they replace the file's.

    Raises:
        SpecError: the file is unreadable or invalid; carries every problem found, at file:line:column.
        UsageError: `path` is none of these.
        PluginError: a plugin of the spec is broken.
    """
    if isinstance(path, Mapping):
        return spec_from_dict(path, overrides)
    if not isinstance(path, str | Path):
        raise UsageError(f"a spec is a path, a name or a dictionary, not {type(path).__name__}")
    files = SpecFiles(path)
    tree = files.load()
    if (specs := tree.get("specs")) is not None:
        hint = f"`karolos suite {shown(str(path))}` trains it"
        raise specs.place.refusal("the file is a suite, not a spec", hint, setting="specs")
    trees = override_trees(overrides, files.count, files.broken)
    if files.broken:
        refuse([*files.problems, *files.broken])
    spec = _spec(tree, [*above, *trees], find_spec(path)[0].stem, files.problems)
    if spec.continued_from is not None:
        what = "only `karolos resume RUN training.steps=...` continues a run; a spec begins one"
        at = next(one["continued_from"].place for one in (*reversed(trees), tree) if one.get("continued_from"))
        raise at.refusal(what, "remove it", setting="continued_from")
    spec._text = files.text
    return spec


def spec_from_dict(spec: Mapping[str, Any], overrides: Iterable[str] = ()) -> Spec:
    """The spec in a dictionary. Raises as `load_spec` does, with "dict" as the position."""
    if not isinstance(spec, Mapping):
        raise UsageError(f"a spec is a dictionary here, not {type(spec).__name__}", hint="load_spec reads files")
    mark = Mark("dict")
    if "extends" in spec:
        raise mark.refusal("a dictionary has no file to extend from", "load it with load_spec", setting="extends")
    problems: list[Problem] = []
    trees = override_trees(overrides, 1, problems)
    refuse(problems)
    return _spec(Node.of(spec, mark).normalised(), trees)


def _resolve(written: Node, changes: Sequence[Node], stem: str | None) -> tuple[Node, Spec | None, list[Problem]]:
    """The written tree with changes on top, its Spec if it is valid, and the problems at their positions.

    Raises PluginError if a plugin is broken; at the position that names it.
    """
    tree = merge(written, changes, stem)
    plugins, problems = bind(tree)
    spec, invalid = validate(tree, plugins)
    return tree, spec, [*problems, *explain(invalid, tree, plugins)]


def _spec(
    written: Node, changes: Sequence[Node] = (), stem: str | None = None, problems: Sequence[Problem] = ()
) -> Spec:
    """The spec of the written tree, with changes on top.

    Raises SpecError if it is invalid; carries these and all other problems, each at the change that causes it.
    """
    tree, spec, found = _resolve(written, changes, stem)
    refuse([*problems, *tree.variable_problems(), *_at_causes(found, written, changes, stem)])
    assert spec is not None  # it has no problems
    if spec.sweep is not None:
        base = Node({key: node for key, node in (tree.mapping or {}).items() if key != SWEEP}, tree.at)
        refuse(space_problems(tree[SWEEP]["space"], spec.sweep, lambda trial: _resolve(base, trial, stem)[2]))
    spec._origins.update({".".join(path): _origin(tree, path) for path, _ in leaves(spec.dump())})
    return spec


def _at_causes(problems: list[Problem], written: Node, changes: Sequence[Node], stem: str | None) -> list[Problem]:
    """The problems, each at the change that causes it, e.g. at `agent=ppo` if the spec's buffer does not fit it.

    A problem keeps its position if that is a change, or if no single change causes it.
    """
    own = {mark for change in changes for node in change.walk() for mark in (node.at, node.key)}
    for place, change in enumerate(changes):
        if all(problem.where in own for problem in problems):
            break  # nothing is left to explain
        # A problem that disappears without this change is caused by it.
        try:
            _, _, without = _resolve(written, [*changes[:place], *changes[place + 1 :]], stem)
        except PluginError:  # the change replaces a broken plugin
            continue
        remaining = {problem.setting for problem in without}
        problems = [
            one if one.where in own or one.setting in remaining else replace(one, where=change.at) for one in problems
        ]
    return problems


def _origin(tree: Node, path: tuple[str, ...]) -> str:
    """The place of the value at `path`, or of the scalar that a plugin's settings made it from."""
    node = tree
    for key in path:
        below = node.get(key)
        if below is None:
            return str(DEFAULT if node.mapping is not None else node.at)
        node = below
    return str(node.at)


def spec_of_trial(base: Spec, drawn: Mapping[str, Any], name: str, seeds: tuple[int, ...], source: str) -> Spec:
    """The spec of one trial of a sweep.

    `drawn`: parameter -> number, or label of a choice. `name`: of the runs. `source`: origin of the settings, e.g.
    "trial 7". Raises SpecError if these values are incompatible; reported at `source`.
    """
    assert base.sweep is not None  # only such a spec has trials
    mark, space = Mark(source), base.sweep.space
    changes = [Node.of(space[key].value(drawn[key]), mark).under(key) for key in application_order(drawn)]
    return _spec(_with_runs(base, name, seeds, mark), changes)


def spec_of_variant(base: Spec, variant: str, name: str, seeds: tuple[int, ...], *, fine_tune: bool = False) -> Spec:
    """The spec of the runs of one variant of a transfer, changed as overrides would change it.

    `fine_tune`: with the settings of fine-tuning, too. Raises SpecError if the settings are incompatible; reported
    where they are set.
    """
    transfer = base.transfer
    assert transfer is not None  # only such a spec has variants
    changes = {transfer.place(variant): transfer.settings[variant]}
    if fine_tune:
        changes["transfer.fine_tune"] = transfer.fine_tune
    trees, origins = [], base.origins
    for place, settings in changes.items():
        for key, value in settings.items():
            mark = Mark(origins.get(f"{place}.{key}", origins.get(place, place)))
            trees.append(Node.of(value, mark).under(key))
    return _spec(_with_runs(base, name, seeds, Mark(f"variant {variant}")), trees)


def spec_without(spec: Spec, setting: str) -> Spec:
    """The spec without a given setting, block or part, which then gets its default."""
    *above, last = segments(setting)
    block = given = spec.given()
    for key in above:
        below = block.get(key)
        block = below if isinstance(below, dict) else {}
    block.pop(last, None)
    found = _spec(Node.of(given, Mark("dict")))
    found._text = spec.text
    found._origins = {path: spec.origins.get(path, str(DEFAULT)) for path in found.origins}
    return found


def _with_runs(base: Spec, name: str, seeds: tuple[int, ...], mark: Mark) -> Node:
    """The resolved spec as a tree, with the name and the seeds of other runs.

    Without defaults: if another plugin replaces one, they would become settings of the other one.
    """
    return Node.of({**base.alone().given(), "name": name, "seeds": list(seeds)}, mark)
