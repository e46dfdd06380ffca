"""Everything that is installed keeps what its kind promises; the promises stand in karolos.plugins.contracts."""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import product

import pytest
from support.robots import ROBOTS

from karolos.plugins.contracts import Case, candidate, cases, environments, pairs, results
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
Promises = Callable[[], Iterable[Case]]
USUAL = {"robots": "panda", "tasks": "reach"}
ANYWHERE = {
    environments.different_seeds_give_different_episodes,
    environments.an_episode_ends_once_and_no_step_follows,
    environments.steps_are_as_the_signature_says,
    environments.the_goal_rule_gives_the_rewards_and_ends_of_the_steps,
    environments.a_step_stays_as_it_was_returned,
    environments.closing_twice_is_safe,
}
"""What no pair and no engine changes: the usual robot shows it with each task, and each robot with the usual task."""


def promises_alone() -> Iterator[tuple[str, Promises]]:
    """What each installed plugin promises by itself, left out those that cannot do without settings."""
    for kind in ("agents", "buffers", "environments", "robots", "grippers", "tasks"):
        for name in names(kind):
            fields = load(kind, name).Settings.model_fields.values()
            if name != "robot_task" and not any(field.is_required() for field in fields):
                yield f"{kind}-{name}", partial(cases, candidate(kind, name), alone=True)
    for name, settings in DISTRIBUTIONS.items():
        yield f"distributions-{name}", partial(cases, candidate("distributions", name, **settings))
    if BULLET.installed:
        # other robots: `karolos plugins check robot NAME --engine bullet`
        usual = candidate("robots", USUAL["robots"], BULLET.name)
        yield f"robots-{usual.name}-bullet", partial(cases, usual, alone=True)


def promises_of_pairs() -> Iterator[tuple[str, Promises]]:
    """What each robot with each task promises; in PyBullet the usual robot with each task."""
    for robot, task in product(ROBOTS, names("tasks")):
        yield f"{robot}-{task}", partial(of_usual_pair, robot, task)
    for task in names("tasks") if BULLET.installed else ():
        # the other robots: `karolos plugins check robot NAME --engine bullet`
        yield f"{USUAL['robots']}-bullet-{task}", partial(of_usual_pair, USUAL["robots"], task, "bullet")


def of_usual_pair(robot: str, task: str, engine: str | None = None) -> Iterator[Case]:
    """Promises of a pair under the control that its task asks for; of usual ones in MuJoCo all."""
    usual = not engine and (robot == USUAL["robots"] or task == USUAL["tasks"])
    for case in of_pair(candidate("robots", robot, engine), candidate("tasks", task)):
        if usual or (in_control_of(task, case) and case.promise not in ANYWHERE):
            yield case


def in_control_of(task: str, case: Case) -> bool:
    """Whether a pair is checked with what actions of the task move."""
    own = load("tasks", task).control
    return case.candidates[0].settings.get("control", own) == own


PROMISES = dict([*promises_alone(), *promises_of_pairs()])


@pytest.mark.parametrize("who", PROMISES)
def test_every_promise_is_kept(who, monkeypatch):
    # `karolos plugins check` plays 10 and 4 episodes and begins 300; bench/ plays hundreds
    for module, name, number in (pairs, "EPISODES", 4), (pairs, "CHANCE_EPISODES", 1), (environments, "STARTS", 50):
        monkeypatch.setattr(module, name, number)
    found = list(results(PROMISES[who]()))
    assert found
    if "bullet" not in who:  # without impedance control nothing can be inserted
        assert pairs.the_task_refuses_the_robot not in {case.promise for case, _ in found}
    assert [f"{case}: {problem}" for case, problem in found if problem is not None] == []
