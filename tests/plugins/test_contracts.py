"""Everything that is installed keeps what its kind promises; the promises stand in karolos.plugins.contracts."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import pytest
import torch

from karolos.plugins.contracts import Case, candidate, cases
from karolos.plugins.contracts.checking import of_pair
from karolos.registry import load, names
from karolos.simulation.engines import BULLET


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Two threads that share a busy core wait for each other longer than they compute."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


DISTRIBUTIONS = {
    "choice": {"values": (1.0, 2.0)},
    "log_uniform": {"low": 0.1, "high": 2.0},
    "normal": {"mean": 1.0, "std": 0.5},
    "uniform": {"low": -1.0, "high": 1.0},
}
"""Settings of those that come with karolos."""


def installed_cases() -> Iterator[Case]:
    """What the installed plugins promise, left out those that cannot do without settings; then robots with tasks."""
    for kind in ("agents", "buffers", "environments", "robots", "grippers", "tasks"):
        for name in names(kind):
            fields = load(kind, name).Settings.model_fields.values()
            if name != "robot_task" and not any(field.is_required() for field in fields):
                yield from cases(candidate(kind, name), alone=True)
    for name, settings in DISTRIBUTIONS.items():
        yield from cases(candidate("distributions", name, **settings))
    for robot, task in product(names("robots"), names("tasks")):
        yield from of_pair(candidate("robots", robot), candidate("tasks", task))
    if BULLET.installed:
        for robot in names("robots"):
            yield from cases(candidate("robots", robot, "bullet"), alone=True)
        # the other robots, and joints where a task moves the tool: `karolos plugins check robot NAME --engine bullet`
        for task in names("tasks"):
            found = of_pair(candidate("robots", "panda", "bullet"), candidate("tasks", task))
            left_out = "" if load("tasks", task).control == "joint" else "-joint-"
            yield from (case for case in found if not left_out or left_out not in str(case))


@pytest.mark.parametrize("case", [*installed_cases()], ids=str)
def test_a_plugin_keeps_its_promise(case: Case) -> None:
    case()
