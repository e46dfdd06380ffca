"""Explains invalid settings: from pydantic's errors to problems with positions in the spec, in words of our own."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel

from ..errors import Problem
from ..registry import alternatives, closest
from .bind import Invalid, Plugins
from .model import Spec
from .tree import DEFAULT, RANDOMIZATION, SWEEP, TRANSFER, Mark, Node, Path, dotted, shown, written

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
"""Kind of pydantic's error -> what the value should be. A value is shown with these."""
SAYS = {
    "value_error": "{error}",
    "assertion_error": "{error}",
    "too_short": "should have at least {min_length} item{s}, not {actual_length}",
    "too_long": "should have at most {max_length} item{s}, not {actual_length}",
    "string_too_short": "should have at least {min_length} character{s}",
    "string_too_long": "should have at most {max_length} character{s}",
}
"""Kind of pydantic's error -> what is wrong. Errors of other kinds speak for themselves."""
LENGTHS = ("too_short", "too_long")
COMPLETE = ("value_error", "assertion_error", *LENGTHS)
"""Kinds of errors that say what the value is instead of what it should be."""
PARAMETERS = {("robot",): "robot.link_mass", ("task",): "task.gravity"}
"""An example of each: what there is is known only once robot and task are made."""
AGENT_HINT = "name a learning algorithm, e.g. `agent: sac`"


def explain(invalid: Iterable[Invalid], tree: Node, plugins: Plugins) -> list[Problem]:
    """One problem for each mistake, at its key or value."""
    return [problem for one in invalid for problem in _problems(one, tree, plugins)]


def _problems(invalid: Invalid, tree: Node, plugins: Plugins) -> Iterator[Problem]:
    block = tree.get(*invalid.path) or tree
    errors: dict[Path, list[dict[str, Any]]] = {}
    unions: set[Path] = set()
    for entry in invalid.error.errors(include_url=False):
        # pydantic's location contains the members of unions, which the spec does not; a missing key stands in neither
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
            continue  # a less specific error of a union's member; the length of a list without its invalid items
        if kind == "missing":
            beside = (str(other[-1]) for other in unknown if other[:-1] == path[:-1])
            if path == ("environment",) or any(closest(other, [str(path[-1])]) for other in beside):
                continue  # `bind` reports it, or it is misspelt
        whole = (*invalid.path, *path)
        what, hint = _said(invalid, path, entries, tree, plugins)
        yield Problem(_place(tree, whole, entries[0]), dotted(whole), what, hint)


def _place(tree: Node, path: Path, entry: Mapping[str, Any]) -> Mark:
    """missing -> the parent's key; unknown -> the key itself; the rest -> the value."""
    node = tree.deepest(path)[0]
    at_key = entry["type"] in ("missing", "extra_forbidden") or "[key]" in entry["loc"]
    mark = node.place if at_key else node.at
    return tree.at if mark == DEFAULT else mark


def _said(
    invalid: Invalid, path: Path, entries: list[dict[str, Any]], tree: Node, plugins: Plugins
) -> tuple[str, str | None]:
    """What is wrong at a path, and a hint. Several errors at one path come from the members of a union."""
    kind, given = entries[0]["type"], entries[0]["input"]
    if kind == "extra_forbidden":
        return "no such key", _known_keys(invalid, path, tree, plugins)
    if kind == "missing":
        return "is missing", AGENT_HINT if (*invalid.path, *path) == ("agent",) else None
    if kind == "string_pattern_mismatch":
        return f"{shown(repr(given))} is not allowed", _pattern_hint(path)
    texts = list(dict.fromkeys(_text(entry) for entry in entries))
    what = " or ".join([texts[0], *(text.removeprefix("should be ") for text in texts[1:])])
    node = tree.get(*invalid.path, *path)
    if node is not None and "should" in what and kind not in COMPLETE:
        what = f"{what}, not {written(node)}"
    contexts = [entry.get("ctx") or {} for entry in entries]
    choices = [word for context in contexts for word in re.findall(r"'([^']+)'", context.get("expected", ""))]
    near = closest(given, choices) if isinstance(given, str) else None
    return what, contexts[0].get("hint") or (f"did you mean {near!r}?" if near else None)


def _text(entry: Mapping[str, Any]) -> str:
    """What one error says: in words of ours for the kinds above, otherwise in its own."""
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
    return "see `karolos plugins show` for what is"


def _known_keys(invalid: Invalid, path: Path, tree: Node, plugins: Plugins) -> str | None:
    """A hint for an unknown key: the most similar one, all that are allowed, or where else it is allowed."""
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
