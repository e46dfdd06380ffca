"""Everything that is installed keeps what its kind promises; the promises stand in karolos.plugins.contracts."""

from collections.abc import Iterator
from itertools import product

import pytest
from support.robots import ROBOTS

from karolos.plugins.contracts import Case, candidate, cases, environments
from karolos.plugins.contracts.checking import of_pair
from karolos.registry import load, names
from karolos.simulation.engines import BULLET

DISTRIBUTIONS = {
    "choice": {"values": (1.0, 2.0)},
    "log_uniform": {"low": 0.1, "high": 2.0},
    "normal": {"mean": 1.0, "std": 0.5},
    "uniform": {"low": -1.0, "high": 1.0},
}
"""Settings of those that come with karolos."""


USUAL = {"robots": "panda", "tasks": "reach"}
ANYWHERE = {
    environments.different_seeds_give_different_episodes,
    environments.an_episode_ends_once_and_no_step_follows,
    environments.steps_are_as_the_signature_says,
    environments.the_goal_rule_gives_the_rewards_and_ends_of_the_steps,
    environments.a_step_stays_as_it_was_returned,
    environments.closing_twice_is_safe,
}
"""What no pair changes: the usual robot shows it with each task, and each robot with the usual task."""


def installed_cases() -> Iterator[Case]:
    """What the installed plugins promise, left out those that cannot do without settings; then robots with tasks."""
    for kind in ("agents", "buffers", "environments", "robots", "grippers", "tasks"):
        for name in names(kind):
            fields = load(kind, name).Settings.model_fields.values()
            if name != "robot_task" and not any(field.is_required() for field in fields):
                yield from cases(candidate(kind, name), alone=True)
    for name, settings in DISTRIBUTIONS.items():
        yield from cases(candidate("distributions", name, **settings))
    for robot, task in product(ROBOTS, names("tasks")):
        usual = robot == USUAL["robots"] or task == USUAL["tasks"]
        for case in of_pair(candidate("robots", robot), candidate("tasks", task)):
            if usual or (in_control_of(task, case) and case.promise not in ANYWHERE):
                yield case
    if BULLET.installed:
        for robot in ROBOTS:
            yield from cases(candidate("robots", robot, "bullet"), alone=True)
        # the other robots: `karolos plugins check robot NAME --engine bullet`
        for task in names("tasks"):
            found = of_pair(candidate("robots", USUAL["robots"], "bullet"), candidate("tasks", task))
            yield from (case for case in found if in_control_of(task, case))


def in_control_of(task: str, case: Case) -> bool:
    """Whether a pair is checked with what actions of the task move."""
    own = load("tasks", task).control
    return case.candidates[0].settings.get("control", own) == own


@pytest.mark.parametrize("case", [*installed_cases()], ids=str)
def test_a_plugin_keeps_its_promise(case: Case) -> None:
    case()
