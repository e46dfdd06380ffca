"""Checks of a spec across its parts."""

from __future__ import annotations

from ..errors import Problem
from ..registry import closest, loaded
from .model import Spec
from .nodes import DEFAULT, Node

ROBOT_TASK = "robot_task"
"""The environment that consists of a robot and a task."""


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
    name = _name(environment)
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
    agent, buffer = loaded("agents", _name(agent_node)), loaded("buffers", _name(buffer_node))
    if agent_node is None or buffer_node is None or not agent or not buffer or agent.on_policy == buffer.on_policy:
        return []
    place = agent_node.place if buffer_node.at is DEFAULT else buffer_node.place
    names = f"agent {_name(agent_node)!r}", f"buffer {_name(buffer_node)!r}"
    if agent.on_policy:
        what = f"{names[0]} learns from its own latest actions only, {names[1]} replays old ones"
        return [Problem(place, "buffer", what, "name an on-policy buffer")]
    what = f"{names[0]} learns from replay, {names[1]} forgets all but the latest actions"
    return [Problem(place, "buffer", what, "name a replay buffer, e.g. uniform")]


def _misspelt(tree: Node, key: str) -> bool:
    """Whether the spec has an unknown key that was most likely meant to be `key`."""
    unknown = [name for name in tree.mapping or {} if name not in Spec.model_fields]
    return any(closest(name, Spec.model_fields) == key for name in unknown)


def _name(part: Node | None) -> str | None:
    name = part.get("name") if part else None
    return name.value if name and isinstance(name.value, str) else None
