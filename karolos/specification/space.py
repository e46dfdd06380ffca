"""Validation of a sweep's search space against the plugins' settings.

Both ends of each range and every value of each choice are validated. Problems are reported at the number or choice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from typing import Any

from ..errors import Problem
from ..registry import alternatives
from .sweep import Sweep
from .tree import RANDOMIZATION, Node, nested, segments

SEARCHABLE = ("robot", "task", "environment", "agent", "buffer", RANDOMIZATION, "demonstrations", "training")
"""Keys of a spec below which settings can be searched."""
FIXED_SETTINGS = {
    "training.steps": "every trial has the same budget",
    "training.device": "it does not change what is learned",
    "training.threads": "it does not change what is learned",
    "testing": "every trial is tested alike",
    "orchestrator": "it says how the machine is shared",
    "seeds": "sweep.seeds says on which seeds",
    "name": "the sweep names its trials",
}
"""Settings that are the same in all trials, and why."""
MAX_COMBINATIONS = 200
"""Largest number of combinations of the choices a parameter depends on with which it is validated."""


def application_order(keys: Iterable[str]) -> list[str]:
    """Parameters in the order of merging: those that replace a whole part before those inside it."""
    return sorted(keys, key=lambda key: (len(segments(key)), segments(key)[-1] != "name"))


def space_problems(space: Node, sweep: Sweep, problems_of: Callable[[Sequence[Node]], list[Problem]]) -> list[Problem]:
    """The problems of a sweep's search space.

    Args:
        space: of the sweep, as it is written.
        problems_of: the problems of the spec without its sweep, with changes on top.
    """
    if problems := [*_wrong_keys(space), *_wrong_conditions(space, sweep)]:
        return problems
    values = {key: _values(space[key], sweep, key) for key in sweep.space}
    wrong: dict[Problem, None] = {}
    refused: set[tuple[str, Any]] = set()  # so that dependent parameters report no further problems
    for key in sorted(sweep.space, key=lambda one: len(_depends(sweep, one))):
        for drawn in _combinations(sweep, key):
            if refused & drawn.items():
                continue
            above = application_order(drawn)
            changes = [nested(name, values[name][drawn[name]]) for name in above]
            if off := _without_settings(above, changes, key):
                what, hint = f"{off} has no such setting when it is {drawn[off]!r}", f"add when: {{{off}: ...}}"
                wrong[Problem(space[key].place, f"sweep.space.{key}", what, hint)] = None
                continue
            for value, node in values[key].items():
                if problems := problems_of([*changes, nested(key, node)]):
                    wrong.update(dict.fromkeys(_at_parameter(space[key], key, problem) for problem in problems))
                    refused.add((key, value))
    return list(wrong)


def _without_settings(above: Sequence[str], changes: Sequence[Node], key: str) -> str | None:
    """The choice above a parameter whose value has no settings, e.g. null; None if all have."""
    for name, change in zip(above, changes, strict=True):
        node = change.get(*segments(name))
        if key.startswith(f"{name}.") and node is not None and node.mapping is None:
            return name
    return None


def _at_parameter(node: Node, key: str, problem: Problem) -> Problem:
    """The problem, moved to the parameter if its position is elsewhere."""
    if any(problem.where in (below.at, below.key) for below in node.walk()):
        return problem
    return Problem(node.place, f"sweep.space.{key}", f"{problem.setting}: {problem.what}", problem.hint)


def _wrong_keys(space: Node) -> Iterator[Problem]:
    for key, node in (space.mapping or {}).items():
        path = f"sweep.space.{key}"
        first = key.partition(".")[0]
        fixed = next(
            (why for prefix, why in FIXED_SETTINGS.items() if key == prefix or key.startswith(f"{prefix}.")), None
        )
        if fixed is not None:
            yield Problem(node.place, path, f"cannot be searched: {fixed}", "remove it")
        elif first not in SEARCHABLE:
            yield Problem(node.place, path, "no such setting", alternatives(first, SEARCHABLE))
        elif not all(segments(key)):
            yield Problem(node.place, path, "is not a path of keys", "write e.g. agent.learning_rate")


def _wrong_conditions(space: Node, sweep: Sweep) -> Iterator[Problem]:
    order = sweep.order()
    for key, parameter in sweep.space.items():
        for on, condition in parameter.when.items():
            node = space[key]["when"][on]
            path = f"sweep.space.{key}.when.{on}"
            other = sweep.space.get(on)
            if other is None or other.choice is None:
                what = "is not a parameter of this sweep" if other is None else "is a range, not a choice"
                names = [name for name, one in sweep.space.items() if one.choice is not None and name != key]
                hint = alternatives(on, names) if names else "name a choice of this sweep"
                yield Problem(node.place, path, what, hint)
                continue
            for unknown in sorted(other.accepted(condition).difference(other.labels)):
                what = f"{on} is never {unknown!r}"
                yield Problem(node.at, path, what, alternatives(unknown, other.labels))
        if key not in order:
            place = space[key]["when"].place
            yield Problem(place, f"sweep.space.{key}.when", "is a circle of conditions", "remove one of them")


def _combinations(sweep: Sweep, key: str) -> Iterator[dict[str, Any]]:
    """The combinations of the choices that a parameter depends on, with which it is active."""
    choices = Sweep.model_construct(space={name: sweep.space[name] for name in _depends(sweep, key)})
    for drawn in islice(choices.combinations(), MAX_COMBINATIONS):
        if sweep.is_active(key, drawn):
            yield drawn


def _depends(sweep: Sweep, key: str) -> list[str]:
    """The choices that determine whether a parameter is active, or the plugin or mapping that contains it."""
    choices: dict[str, None] = {}
    waiting = [key]
    while waiting:
        one = waiting.pop()
        around = [
            name
            for name, other in sweep.space.items()
            if other.choice is not None and name != one and one.startswith(f"{name.removesuffix('.name')}.")
        ]
        more = [name for name in (*around, *sweep.space[one].when) if name != key and name not in choices]
        choices.update(dict.fromkeys(more))
        waiting.extend(more)
    return list(choices)


def _values(node: Node, sweep: Sweep, key: str) -> dict[Any, Node]:
    """The values to try, both ends of a range or the labels of all choices, and their nodes in the search space."""
    parameter = sweep.space[key]
    kind = next(kind for kind in ("float", "int", "choice") if getattr(parameter, kind) is not None)
    nodes = node[kind].items if node[kind].mapping is None else list(node[kind].value.values())
    values = parameter.bounds if parameter.choice is None else parameter.labels
    return {value: below.with_key(node.key) for value, below in zip(values, nodes or (), strict=True)}
