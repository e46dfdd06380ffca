"""Converts pydantic's errors to problems with source positions."""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from ..errors import Problem
from ..registry import alternatives, closest, loaded
from .merge import PARTS, RANDOMIZATION, SWEEP, TRANSFER, is_part
from .model import Spec
from .nodes import DEFAULT, Mark, Node, Path, dotted, shown
from .parts import validate_strictly

_WORDS = (
    ("Input should be", "should be"),
    ("String should", "should"),
    ("Tuple should", "should"),
    ("List should", "should"),
    ("Dictionary should", "should"),
    (" after validation", ""),
    ("Value error, ", ""),
    ("Assertion failed, ", ""),
    (" a valid array", " a list"),
    (" a valid tuple", " a list"),
    (" a valid list", " a list"),
    (" an object", " a mapping"),
    (" a valid dictionary", " a mapping"),
    (" a valid boolean", " true or false"),
    (" a valid ", " a "),
    (" a integer", " an integer"),
)
ROBOT_TASK = "robot_task"
"""The environment that consists of a robot and a task."""
PARAMETERS = {"robot": "robot.link_mass", "task": "task.gravity"}
"""An example of each: what there is is known only once robot and task are made."""
AGENT_HINT = "name a learning algorithm, e.g. `agent: sac`"
ROLLOUT_HINT = "name an on-policy buffer, e.g. buffer=on_policy; the spec panda_reach_ppo shows the settings of both"
_LENGTH = ("too_short", "too_long")
_UNSHOWN = ("secret", "value_error", "assertion_error", "unknown_name", "missing_name", "part_type", *_LENGTH)
"""Errors whose message does not show the value."""


def validate(tree: Node) -> tuple[Spec | None, list[Problem]]:
    """The spec in a tree of nodes, None if it is invalid, and its problems.

    Raises:
        PluginError: a plugin of the spec is broken.
    """
    problems = [*environment_problems(tree), *pairing_problems(tree)]
    try:
        return validate_strictly(Spec, tree.plain()), problems
    except ValidationError as error:
        return None, [*problems, *located_problems(error, tree)]


def located_problems(error: ValidationError, tree: Node, model: type[BaseModel] = Spec) -> list[Problem]:
    """One problem for each mistake in what should be this model, at its key or value."""
    errors: dict[Path, list[dict[str, Any]]] = {}
    union_paths: set[Path] = set()
    for entry in error.errors(include_url=False):
        path, tagged = _untagged(tree, entry["loc"], entry["type"])
        errors.setdefault(path, []).append(dict(entry))
        if tagged:
            union_paths.add(path)
    for path in list(errors):
        deeper = any(other != path and other[: len(path)] == path for other in errors)
        if deeper and (path in union_paths or errors[path][0]["type"] in _LENGTH):
            del errors[
                path
            ]  # a less specific error of a union's member; the length of a list without its invalid items
    unknown = [path for path, entries in errors.items() if entries[0]["type"] == "extra_forbidden"]
    return [
        _problem(tree, path, entries, model)
        for path, entries in errors.items()
        if entries[0]["type"] != "missing" or not _reported_elsewhere(path, unknown)
    ]


def _reported_elsewhere(path: Path, unknown: Iterable[Path]) -> bool:
    """Whether a missing key is reported elsewhere: as a misspelt key beside it, or by the check of environments."""
    beside = (other for other in unknown if other[:-1] == path[:-1])
    return path == ("environment",) or any(closest(str(other[-1]), [str(path[-1])]) for other in beside)


def _untagged(tree: Node, location: Iterable[str | int], kind: str) -> tuple[Path, bool]:
    """The path in the spec of an error's location, and whether the location contains pydantic's union tags."""
    steps = [step for step in location if step != "[key]"]
    path: Path = ()
    node: Node | None = tree
    tagged = False
    for place, step in enumerate(steps):
        below = node.get(step) if node else None
        last = place == len(steps) - 1
        if below is not None:
            node, path = below, (*path, step)
        elif last and kind in ("missing", "missing_name"):
            path = (*path, step)
        else:
            tagged = True
    return path, tagged


def _problem(tree: Node, path: Path, entries: list[dict[str, Any]], model: type[BaseModel]) -> Problem:
    """The problem at a path. Several errors at one path come from the members of a union and are joined by "or"."""
    kind = entries[0]["type"]
    place = _place(tree, path, kind, at_key="[key]" in entries[0]["loc"])
    text = dotted(path)
    if kind == "extra_forbidden":
        allowed = _allowed(tree, path, model)
        hint = alternatives(str(path[-1]), allowed) if allowed else None
        if len(path) == 2 and path[0] in PARAMETERS and not closest(str(path[-1]), allowed):
            parameter, name = PARAMETERS[path[0]], _named(tree.get(path[0]))
            hint = f"{hint}; a parameter of the world is set as e.g. randomization: {{{parameter}: NUMBER}}"
            hint = f"{hint}; `karolos inspect {path[0]} {name}` shows all"
        elif len(path) == 1 and model is Spec and (below := _one_level_down(tree, text)):
            near = get_close_matches(text, allowed, n=1, cutoff=0.8)
            hint = f"did you mean {' or '.join(near + below)}?"
        return Problem(place, text, "no such key", hint)
    if kind == "missing":
        return Problem(place, text, "is missing", AGENT_HINT if path == ("agent",) else None)
    messages = [entry["msg"] for entry in entries]
    for old, new in _WORDS:
        messages = [message.replace(old, new) for message in messages]
    messages = list(dict.fromkeys(message[:1].lower() + message[1:] for message in messages))
    whats = [messages[0], *(message.removeprefix("should be ") for message in messages[1:])]
    what = " or ".join(whats)
    given = entries[0]["input"]
    if kind == "string_pattern_mismatch":
        what, hint = f"{shown(repr(given))} is not allowed", _pattern_hint(path)
        return Problem(place, text, what, hint)
    node = tree.get(*path)
    if kind not in _UNSHOWN and node is not None:
        what = f"{what}, not {_written(node)}"
    return Problem(place, text, what, (entries[0].get("ctx") or {}).get("hint") or _near_choice(entries, given))


def _place(tree: Node, path: Path, kind: str, *, at_key: bool) -> Mark:
    """missing -> the parent's key; unknown -> the key itself; the rest -> the value."""
    node = tree.get(*path)
    if kind in ("missing", "missing_name") or node is None:
        node, whole = tree.get(*path[:-1]) or tree, True
    else:
        whole = at_key or kind == "extra_forbidden"
    mark = node.place if whole else node.at
    return tree.at if mark == DEFAULT else mark


def _pattern_hint(path: Path) -> str:
    if path == ("name",):
        return "give `name`: at most 64 letters, digits, dots, underscores and hyphens, the first a letter or digit"
    if len(path) == 2 and path[0] == RANDOMIZATION:
        return "write robot.<parameter> or task.<parameter>, e.g. task.gravity"
    return "see `karolos plugins show` for what is"


def _written(node: Node) -> str:
    if node.mapping is not None:
        return "a mapping"
    if node.items is not None:
        return "a list"
    if node.value is None or isinstance(node.value, bool):
        return {None: "null", True: "true", False: "false"}[node.value]
    return shown(repr(node.value))


def _near_choice(entries: list[dict[str, Any]], given: object) -> str | None:
    """A hint at the closest choice of a literal."""
    if not isinstance(given, str):
        return None
    choices = [
        word for entry in entries for word in re.findall(r"'([^']+)'", (entry.get("ctx") or {}).get("expected", ""))
    ]
    match = closest(given, choices)
    return f"did you mean {match!r}?" if match else None


def _allowed(tree: Node, path: Path, model: type[BaseModel]) -> list[str]:
    """The allowed keys at the last position of `path`."""
    steps = tuple(str(step) for step in path[:-1])
    if not steps:
        return ["extends", *model.model_fields]
    depth = next((length for length in (1, 2) if is_part(steps[:length])), 0)
    if not depth:
        return _keys([model], path[:-1])
    kind = PARTS.get(steps[0], "distributions")
    name = tree.get(*steps[:depth], "name")
    plugin = loaded(kind, name.value) if name else None
    if name and plugin is None:
        return []
    keys = _keys([plugin.Settings], path[depth:-1]) if plugin else []
    return ["name", *keys] if len(path) == depth + 1 else keys


def _one_level_down(tree: Node, key: str) -> list[str]:
    """The settings of this name in the sections of a spec, e.g. training.steps; not those of a sweep or a transfer."""
    sections = [section for section in Spec.model_fields if section not in (SWEEP, TRANSFER)]
    return [f"{section}.{key}" for section in sections if key in _allowed(tree, (section, key), Spec)]


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


def environment_problems(tree: Node) -> list[Problem]:
    """Robot and task require each other, and the environment robot_task."""
    given = {key: node for key in ("robot", "task") if (node := tree.get(key)) is not None}
    missing = [key for key in ("robot", "task") if key not in given]
    environment = tree.get("environment")
    if environment is None:
        if any(_misspelt(tree, key) for key in ("robot", "task", "environment")):
            return []  # validation reports the misspelt key, which may be the only problem
        if not given:
            return [Problem(tree.at, "", "has no environment", "give robot and task, or environment")]
        return [
            Problem(node.place, key, f"requires a {missing[0]}", f"add {missing[0]}") for key, node in given.items()
        ]
    name = _named(environment)
    if name is None:
        return []
    if name == ROBOT_TASK:
        missing = [key for key in missing if not _misspelt(tree, key)]
        what, hint = f"{ROBOT_TASK} requires a {' and a '.join(missing)}", f"add {' and '.join(missing)}"
        return [Problem(environment.place, "environment", what, hint)] if missing else []
    what = f"requires environment {ROBOT_TASK}, not {name!r}"
    problems = [Problem(node.place, key, what, f"remove {key}, or write null") for key, node in given.items()]
    drawn = tree.get("randomization")
    if drawn is not None and drawn.mapping:
        what = f"environment {name!r} has no robot or task to randomize"
        problems.append(Problem(drawn.place, "randomization", what, "remove it, or write null"))
    return problems


def pairing_problems(tree: Node) -> list[Problem]:
    """An on-policy agent needs an on-policy buffer, an off-policy agent a replay buffer."""
    agent_node, buffer_node = tree.get("agent"), tree.get("buffer")
    agent, buffer = loaded("agents", _named(agent_node)), loaded("buffers", _named(buffer_node))
    if agent_node is None or buffer_node is None or not agent or not buffer or agent.on_policy == buffer.on_policy:
        return []
    place = agent_node.place if buffer_node.at is DEFAULT else buffer_node.place
    names = f"agent {_named(agent_node)!r}", f"buffer {_named(buffer_node)!r}"
    if agent.on_policy:
        what = f"{names[0]} learns from its own latest actions only, {names[1]} replays old ones"
        return [Problem(place, "buffer", what, ROLLOUT_HINT)]
    what = f"{names[0]} learns from replay, {names[1]} forgets all but the latest actions"
    return [Problem(place, "buffer", what, "name a replay buffer, e.g. buffer=uniform")]


def _misspelt(tree: Node, key: str) -> bool:
    """Whether the spec has an unknown key that was most likely meant to be `key`."""
    unknown = [name for name in tree.mapping or {} if name not in Spec.model_fields]
    return any(closest(name, Spec.model_fields) == key for name in unknown)


def _named(part: Node | None) -> str | None:
    name = part.get("name") if part else None
    return name.value if name and isinstance(name.value, str) else None
