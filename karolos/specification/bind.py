"""Turns a merged tree into a Spec: binds the plugins that its parts name, validates settings, explains mistakes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from ..errors import PluginError, Problem, UsageError, alternatives, closest
from ..registry import load, singular
from .model import Spec
from .parts import Part, validate_strictly
from .tree import DEFAULT, PARTS, RANDOMIZATION, ROBOT_TASK, SWEEP, TRANSFER, Mark, Node, Path, dotted, shown

ROLLOUT_HINT = "name an on-policy buffer, e.g. buffer=on_policy; the spec panda_reach_ppo shows the settings of both"
Plugins = Mapping[tuple[str, ...], type[Any]]
"""Path of a part -> its plugin."""


@dataclass(frozen=True)
class Invalid:
    """Pydantic's errors at a path of the spec that should hold this model."""

    path: Path
    model: type[BaseModel]
    error: ValidationError


def bind(tree: Node) -> tuple[Plugins, list[Problem]]:
    """The plugins that the tree's parts name, imported one at a time, and problems with these names.

    Raises PluginError if a plugin is broken; at the position that names it.
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
            problems.append(Problem(name.at, setting, f"should be the name of {named}, not {name.text}"))
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
    """The spec in a tree, None if it is invalid, and pydantic's errors.

    Each part is validated by its plugin's `Settings`, everything else by `Spec`.
    """
    invalid: list[Invalid] = []
    parts: dict[str, Part] = {}
    plain = tree.plain()
    for path in _parts(tree):
        *above, key = path
        holder, place = (plain[above[0]] if above else plain), ".".join(path)
        given, holder[key] = holder[key], place  # `OfKind` finds the validated part by its place
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


SHOULD_BE = {
    "none_required": "null",
    "bool_type": "true or false",
    "int_type": "an integer",
    "int_from_float": "an integer",
    "float_type": "a number",
    "finite_number": "a finite number",
    "string_type": "a string",
    "path_type": "a path",
    **dict.fromkeys(("list_type", "tuple_type", "set_type", "frozen_set_type"), "a list"),
    **dict.fromkeys(("model_type", "dict_type", "dataclass_type"), "a mapping"),
    "greater_than": "greater than {gt}",
    "greater_than_equal": "greater than or equal to {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "less than or equal to {le}",
    "multiple_of": "a multiple of {multiple_of}",
    "literal_error": "{expected}",
    "enum": "{expected}",
}
"""Kind of pydantic's error -> the allowed values. The given value is shown with these."""
SAYS = {
    "value_error": "{error}",
    "assertion_error": "{error}",
    "too_short": "should have at least {min_length} item{s}, not {actual_length}",
    "too_long": "should have at most {max_length} item{s}, not {actual_length}",
    "string_too_short": "should have at least {min_length} character{s}",
    "string_too_long": "should have at most {max_length} character{s}",
}
"""Kind of pydantic's error -> the mistake. Errors of other kinds keep pydantic's words."""
LENGTHS = ("too_short", "too_long")
COMPLETE = ("value_error", "assertion_error", *LENGTHS)
"""Kinds of errors that describe the given value instead of the allowed ones."""
PARAMETERS = {("robot",): "robot.link_mass", ("task",): "task.gravity"}
"""An example of each. The parameters are known only once robot and task are made."""
AGENT_HINT = "name a learning algorithm, e.g. `agent: sac`"


def explain(invalid: Iterable[Invalid], tree: Node, plugins: Plugins) -> list[Problem]:
    """One problem for each mistake, at its key or value."""
    return [problem for one in invalid for problem in _problems(one, tree, plugins)]


def _problems(invalid: Invalid, tree: Node, plugins: Plugins) -> Iterator[Problem]:
    block = tree.get(*invalid.path) or tree
    errors: dict[Path, list[dict[str, Any]]] = {}
    unions: set[Path] = set()
    for entry in invalid.error.errors(include_url=False):
        # pydantic's location contains the members of unions, the spec does not; a missing key is in neither
        steps = [step for step in entry["loc"] if step != "[key]"]
        missing = steps[-1:] if entry["type"] == "missing" else []
        path = (*block.deepest(steps[: len(steps) - len(missing)])[1], *missing)
        errors.setdefault(path, []).append(dict(entry))
        if len(path) < len(steps):
            unions.add(path)
    unknown = [path for path, (first, *_) in errors.items() if first["type"] == "extra_forbidden"]
    for path, entries in errors.items():
        kind = entries[0]["type"]
        deeper = any(other != path and other[: len(path)] == path for other in errors)
        if deeper and (path in unions or kind in LENGTHS):
            continue  # a less specific error of a union's member, or the length of a list without its invalid items
        if kind == "missing":
            siblings = (str(other[-1]) for other in unknown if other[:-1] == path[:-1])
            if path == ("environment",) or any(closest(other, [str(path[-1])]) for other in siblings):
                continue  # `bind` reports it, or it is misspelt
        whole = (*invalid.path, *path)
        what, hint = _what_and_hint(invalid, path, entries, tree, plugins)
        yield Problem(_place(tree, whole, entries[0]), dotted(whole), what, hint)


def _place(tree: Node, path: Path, entry: Mapping[str, Any]) -> Mark:
    """Position of a mistake: missing key -> the parent's key; unknown key -> the key itself; the rest -> the value."""
    node = tree.deepest(path)[0]
    at_key = entry["type"] in ("missing", "extra_forbidden") or "[key]" in entry["loc"]
    mark = node.place if at_key else node.at
    return tree.at if mark == DEFAULT else mark


def _what_and_hint(
    invalid: Invalid, path: Path, entries: list[dict[str, Any]], tree: Node, plugins: Plugins
) -> tuple[str, str | None]:
    """The mistake at a path, and a hint. Several errors at one path come from the members of a union."""
    kind, given = entries[0]["type"], entries[0]["input"]
    if kind == "extra_forbidden":
        return "no such key", _known_keys(invalid, path, tree, plugins)
    if kind == "missing":
        return "is missing", AGENT_HINT if (*invalid.path, *path) == ("agent",) else None
    if kind == "string_pattern_mismatch":
        return f"{shown(repr(given))} is not allowed", _pattern_hint(path)
    if kind == "string_type" and isinstance(given, int | float) and len(entries) == 1:
        return f"should be a string, not {shown(repr(given))}", "write it in quotes, also within those of a shell"
    texts = list(dict.fromkeys(_text(entry) for entry in entries))
    what = " or ".join([texts[0], *(text.removeprefix("should be ") for text in texts[1:])])
    node = tree.get(*invalid.path, *path)
    if node is not None and "should" in what and kind not in COMPLETE:
        what = f"{what}, not {node.text}"
    contexts = [entry.get("ctx") or {} for entry in entries]
    choices = [word for context in contexts for word in re.findall(r"'([^']+)'", context.get("expected", ""))]
    near = closest(given, choices) if isinstance(given, str) else None
    return what, contexts[0].get("hint") or (f"did you mean {near!r}?" if near else None)


def _text(entry: Mapping[str, Any]) -> str:
    """The text of one error: ours for the kinds above, otherwise pydantic's."""
    kind, context = entry["type"], dict(entry.get("ctx") or {})
    for key, value in context.items():
        if isinstance(value, float) and value.is_integer():
            context[key] = int(value)
    context["s"] = "" if 1 in (context.get("min_length"), context.get("max_length")) else "s"
    if kind in SHOULD_BE:
        return "should be " + SHOULD_BE[kind].format_map(context)
    if kind in SAYS:
        return SAYS[kind].format_map(context)
    message: str = entry["msg"]
    return message[:1].lower() + message[1:]


def _pattern_hint(path: Path) -> str:
    if path == ("name",):
        return "give `name`: at most 64 letters, digits, dots, underscores and hyphens, the first a letter or digit"
    if len(path) == 2 and path[0] == RANDOMIZATION:
        return "write robot.<parameter> or task.<parameter>, e.g. task.gravity"
    if path[:2] == (TRANSFER, "variants"):
        return "a variant has at most 24 letters, digits, dots, underscores and hyphens, the first a letter or digit"
    return "see `karolos plugins show` for what is"


def _known_keys(invalid: Invalid, path: Path, tree: Node, plugins: Plugins) -> str | None:
    """A hint for an unknown key: the most similar key, all allowed keys, or another place where the key is allowed."""
    key = str(path[-1])
    allowed = _keys([invalid.model], path[:-1])
    if len(path) > 1:
        return alternatives(key, allowed)
    allowed = ["name" if invalid.path else "extends", *allowed]
    hint = alternatives(key, allowed)
    if invalid.path in PARAMETERS and not closest(key, allowed):
        kind, name = invalid.path[0], tree.get(*invalid.path, "name")
        example = f"randomization: {{{PARAMETERS[invalid.path]}: NUMBER}}"
        return (
            f"{hint}; a parameter of the world is set as e.g. {example}; "
            f"`karolos inspect {kind} {name and name.value}` shows all"
        )
    if invalid.model is Spec:
        # one level down, e.g. training.steps, but not in a sweep or a transfer
        blocks = {block: models_in(field.annotation) for block, field in Spec.model_fields.items()}
        blocks |= {block: [plugin.Settings] for (block, *rest), plugin in plugins.items() if not rest}
        below = [
            f"{block}.{key}"
            for block, models in blocks.items()
            if block not in (SWEEP, TRANSFER) and key in _keys(models, ())
        ]
        if below:
            return f"did you mean {' or '.join([*get_close_matches(key, allowed, n=1, cutoff=0.8), *below])}?"
    return hint


def _keys(models: list[type[BaseModel]], path: Path) -> list[str]:
    """The fields of the models at `path` below these models; several for a union."""
    for step in path:
        if isinstance(step, str):
            fields = [model.model_fields[step] for model in models if step in model.model_fields]
            if fields:  # otherwise a key of a mapping whose values are these models, as in a search space
                models = [model for field in fields for model in models_in(field.annotation)]
    return list(dict.fromkeys(name for model in models for name in model.model_fields))


def models_in(annotation: Any) -> list[type[BaseModel]]:
    """The pydantic models named anywhere in a type, e.g. in `Hindsight | None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in models_in(argument)]
