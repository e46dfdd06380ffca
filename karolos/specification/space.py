"""Validation of a sweep's search space against the plugins' settings.

Both ends of each range and every value of each choice are validated. Problems are reported at the number or choice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Set
from itertools import islice
from typing import Any

from ..errors import Problem
from ..registry import alternatives
from .merge import RANDOMIZATION, SWEEP, merged, nested, segments, with_shared_settings
from .nodes import Node
from .problems import validate
from .sweep import Sweep

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


def space_problems(tree: Node, sweep: Sweep, complete: Callable[[Node], Node]) -> list[Problem]:
    """The problems of a sweep's search space.

    Args:
        tree: the spec, valid except for its sweep.
        sweep: of the tree.
        complete: adds default parts, after names have changed.
    """
    space = tree[SWEEP]["space"]
    problems = [*_wrong_keys(space), *_wrong_conditions(space, sweep)]
    if problems:
        return problems
    entries = {key: node for key, node in (tree.mapping or {}).items() if key != SWEEP}
    base = Node(entries, tree.at, tree.key)
    wrong_values: dict[Problem, None] = {}
    refused: set[tuple[str, Any]] = set()
    for key in sorted(sweep.space, key=lambda one: len(_depends(sweep, one))):
        for value, probe in _probes(base, space, sweep, key, refused):
            wrong = [probe] if isinstance(probe, Problem) else validate(complete(probe))[1]
            wrong_values.update(dict.fromkeys(_at_parameter(space[key], key, problem) for problem in wrong))
            if wrong:
                refused.add((key, value))  # so that dependent parameters report no further problems
    return list(wrong_values)


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


def _probes(
    base: Node, space: Node, sweep: Sweep, key: str, refused: Set[tuple[str, Any]]
) -> Iterator[tuple[Any, Node | Problem]]:
    """Values of a parameter (both ends, or all choices) with their specs, for all combinations it depends on.

    Skips choices in `refused`. Yields a problem instead of a spec if the parameter cannot be merged.
    """
    depends = _depends(sweep, key)
    part = Sweep.model_construct(space={name: sweep.space[name] for name in depends})
    for drawn in islice(part.combinations(), MAX_COMBINATIONS):
        if not sweep.is_active(key, drawn) or refused & drawn.items():
            continue
        tree = base
        above = application_order(drawn)
        for name in above:
            tree = _with(tree, name, _values(space, sweep, name)[drawn[name]])
        home = tree.get(*segments(key)[:-1])
        if home is not None and home.mapping is None:
            off = next((name for name in reversed(above) if key.startswith(f"{name}.")), None)
            if off is not None:
                what = f"{off} has no such setting when it is {drawn[off]!r}"
                yield None, Problem(space[key].place, f"sweep.space.{key}", what, f"add when: {{{off}: ...}}")
                continue
        for value, node in _values(space, sweep, key).items():
            yield value, _with(tree, key, node)


def _with(tree: Node, key: str, value: Node) -> Node:
    override = nested(key, value)
    return merged(tree, with_shared_settings(tree, override))


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


def _values(space: Node, sweep: Sweep, key: str) -> dict[Any, Node]:
    """The values to try, both ends of a range or the labels of all choices, and their nodes in the search space."""
    parameter, node = sweep.space[key], space[key]
    kind = next(kind for kind in ("float", "int", "choice") if getattr(parameter, kind) is not None)
    nodes = node[kind].items if node[kind].mapping is None else list(node[kind].value.values())
    values = parameter.bounds if parameter.choice is None else parameter.labels
    return {value: below.with_key(node.key) for value, below in zip(values, nodes or (), strict=True)}
