"""Everything that is installed keeps what its kind promises; the promises stand in karolos.plugins.contracts."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch

from karolos.plugins.contracts import Case, candidate, cases
from karolos.plugins.contracts.checking import of_pair
from karolos.registry import load, names
from karolos.simulation.engines import installed


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Two threads that share a busy core wait for each other longer than they compute."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def plugins(kind: str) -> list[Case]:
    """What the installed plugins of a kind promise, each by itself; left out: those that cannot do without settings."""
    found = []
    for name in names(kind):
        fields = load(kind, name).Settings.model_fields.values()
        if name != "robot_task" and not any(field.is_required() for field in fields):
            found += cases(candidate(kind, name), alone=True)
    return found


@pytest.mark.parametrize("case", plugins("agents"), ids=str)
def test_an_agent_keeps_its_promise(case: Case) -> None:
    case()


@pytest.mark.parametrize("case", plugins("buffers"), ids=str)
def test_a_buffer_keeps_its_promise(case: Case) -> None:
    case()


@pytest.mark.parametrize("case", plugins("environments"), ids=str)
def test_an_environment_keeps_its_promise(case: Case) -> None:
    case()


@pytest.mark.parametrize("case", plugins("robots"), ids=str)
def test_a_robot_keeps_its_promise(case: Case) -> None:
    case()


@pytest.mark.parametrize("case", plugins("tasks"), ids=str)
def test_a_task_keeps_its_promise(case: Case) -> None:
    case()


@pytest.mark.skipif(not installed("mujoco"), reason="MuJoCo is not installed")
@pytest.mark.parametrize(
    "case",
    [case for name in names("robots") for case in cases(candidate("robots", name, "mujoco"), alone=True)],
    ids=str,
)
def test_a_robot_keeps_its_promise_with_mujoco(case: Case) -> None:
    case()


PAIRS = [
    case
    for robot in names("robots")
    for task in names("tasks")
    for case in of_pair(candidate("robots", robot), candidate("tasks", task))
]
if installed("mujoco"):  # the other robots: `karolos plugins check robot NAME --engine mujoco`
    for name in names("tasks"):
        PAIRS += of_pair(candidate("robots", "panda", "mujoco"), candidate("tasks", name))


@pytest.mark.parametrize("case", PAIRS, ids=str)
def test_a_robot_with_a_task_keeps_its_promise(case: Case) -> None:
    case()


DISTRIBUTIONS = {
    "choice": {"values": (1.0, 2.0)},
    "log_uniform": {"low": 0.1, "high": 2.0},
    "normal": {"mean": 1.0, "std": 0.5},
    "uniform": {"low": -1.0, "high": 1.0},
}
"""Settings of those that come with karolos."""


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_a_distribution_keeps_its_promises(name: str) -> None:
    for case in cases(candidate("distributions", name, **DISTRIBUTIONS[name])):
        case()
