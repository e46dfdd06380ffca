"""From a merged tree to a Spec: which plugins its parts name, and whether what they are given is valid."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ValidationError

from ..errors import PluginError, Problem, UsageError
from ..registry import closest, load, singular
from .model import Spec
from .parts import Part, validate_strictly
from .tree import DEFAULT, PARTS, RANDOMIZATION, ROBOT_TASK, Node, Path, dotted, written

ROLLOUT_HINT = "name an on-policy buffer, e.g. buffer=on_policy; the spec panda_reach_ppo shows the settings of both"
Plugins = Mapping[tuple[str, ...], type[Any]]
"""Path of a part -> its plugin."""


@dataclass(frozen=True)
class Invalid:
    """Pydantic's errors in what stands at a path of the spec and should be this model."""

    path: Path
    model: type[BaseModel]
    error: ValidationError


def bind(tree: Node) -> tuple[Plugins, list[Problem]]:
    """The plugins that the tree's parts name, imported one at a time, and the problems of these names.

    Raises:
        PluginError: a plugin is broken; at the position that names it.
    """
    plugins: dict[tuple[str, ...], type[Any]] = {}
    problems = list(_environment_problems(tree))
    for path, part in _parts(tree).items():
        name, setting, noun = part.get("name"), dotted((*path, "name")), singular(_kind(path))
        named = f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"
        if part.mapping is None:
            number = "a number, " if path[0] == RANDOMIZATION else ""
            what = f"should be {number}the name of {named}, or a mapping with `name`"
            problems.append(Problem(part.at, dotted(path), what))
        elif name is None:
            problems.append(Problem(part.place, setting, f"should name {named}"))
        elif not isinstance(name.value, str):
            problems.append(Problem(name.at, setting, f"should be the name of {named}, not {written(name)}"))
        else:
            try:
                plugins[path] = load(_kind(path), name.value)
            except UsageError as error:
                problems.append(Problem(name.at, setting, error.what, error.hint))
            except PluginError as error:
                what = f"{error.where}: {error.what}" if error.where else error.what
                at = str(name.at)
                raise PluginError(what, where=at, setting=setting, plugin=error.plugin, hint=error.hint) from None
    return plugins, [*problems, *_pairing_problems(tree, plugins)]


def validate(tree: Node, plugins: Plugins) -> tuple[Spec | None, list[Invalid]]:
    """The spec in a tree, None if it is invalid, and what pydantic says of it.

    Each part is validated by its plugin's `Settings`, everything else by `Spec`.
    """
    invalid: list[Invalid] = []
    parts: dict[str, Part] = {}
    plain = tree.plain()
    for path in _parts(tree):
        *above, key = path
        holder, place = (plain[above[0]] if above else plain), ".".join(path)
        given, holder[key] = holder[key], place  # `OfKind` takes the part from the context
        if path in plugins:
            try:
                parts[place] = Part.of(_kind(path), given.pop("name"), given)
            except ValidationError as error:
                invalid.append(Invalid(path, plugins[path].Settings, error))
    try:
        spec: Spec = validate_strictly(Spec, plain, parts)
    except ValidationError as error:
        return None, [*invalid, Invalid((), Spec, error)]
    return (None if invalid else spec), invalid


def _parts(tree: Node) -> dict[tuple[str, ...], Node]:
    """The nodes of the spec's parts by their paths."""
    drawn = tree.get(RANDOMIZATION)
    parts = {(key,): node for key in PARTS if (node := tree.get(key)) is not None}
    return parts | {(RANDOMIZATION, key): node for key, node in ((drawn and drawn.mapping) or {}).items()}


def _kind(path: tuple[str, ...]) -> str:
    return PARTS.get(path[0], "distributions")


def _environment_problems(tree: Node) -> Iterator[Problem]:
    """Robot and task require each other, and the environment robot_task."""
    given = {key: node for key in ("robot", "task") if (node := tree.get(key)) is not None}
    missing = [key for key in ("robot", "task") if key not in given]
    environment, name = tree.get("environment"), tree.get("environment", "name")
    if environment is None:
        if any(_misspelt(tree, key) for key in ("robot", "task", "environment")):
            return  # validation reports the misspelt key, which may be the only problem
        if not given:
            yield Problem(tree.at, "", "has no environment", "give robot and task, or environment")
        for key, node in given.items():
            yield Problem(node.place, key, f"requires a {missing[0]}", f"add {missing[0]}")
    elif name is not None and name.value == ROBOT_TASK:
        if missing := [key for key in missing if not _misspelt(tree, key)]:
            what = f"{ROBOT_TASK} requires a {' and a '.join(missing)}"
            yield Problem(environment.place, "environment", what, f"add {' and '.join(missing)}")
    elif name is not None and isinstance(name.value, str):
        for key, node in given.items():
            what = f"requires environment {ROBOT_TASK}, not {name.value!r}"
            yield Problem(node.place, key, what, f"remove {key}, or write null")
        if (drawn := tree.get(RANDOMIZATION)) is not None and drawn.mapping:
            what = f"environment {name.value!r} has no robot or task to randomize"
            yield Problem(drawn.place, RANDOMIZATION, what, "remove it, or write null")


def _misspelt(tree: Node, key: str) -> bool:
    """Whether the spec has an unknown key that was most likely meant to be `key`."""
    unknown = [name for name in tree.mapping or {} if name not in Spec.model_fields]
    return any(closest(name, Spec.model_fields) == key for name in unknown)


def _pairing_problems(tree: Node, plugins: Plugins) -> Iterator[Problem]:
    """An on-policy agent needs an on-policy buffer, an off-policy agent a replay buffer."""
    agent, buffer = plugins.get(("agent",)), plugins.get(("buffer",))
    if agent is None or buffer is None or agent.on_policy == buffer.on_policy:
        return
    place = (tree["agent"] if tree["buffer"].at is DEFAULT else tree["buffer"]).place
    names = f"agent {tree['agent']['name'].value!r}", f"buffer {tree['buffer']['name'].value!r}"
    if agent.on_policy:
        what = f"{names[0]} learns from its own latest actions only, {names[1]} replays old ones"
        yield Problem(place, "buffer", what, ROLLOUT_HINT)
    else:
        what = f"{names[0]} learns from replay, {names[1]} forgets all but the latest actions"
        yield Problem(place, "buffer", what, "name a replay buffer, e.g. buffer=uniform")
