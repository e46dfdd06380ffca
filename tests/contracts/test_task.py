"""What every task promises."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from building import PAIRS, robot_task

from karolos.playing import expert_policy
from karolos.registry import load, names
from karolos.scoring import random_policy, score


@pytest.fixture(params=names("tasks"))
def task(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def test_docstring_says_what_to_do_what_is_randomised_and_what_counts(task: str) -> None:
    text = load("tasks", task).__doc__
    for heading in ("What to do:", "What is randomised:", "What counts as success:"):
        assert heading in text


@pytest.mark.parametrize("reward", ["sparse", "dense"])
def test_goal_rule_survives_pickling_and_works_on_leading_axes(task: str, reward: str) -> None:
    environment = robot_task(task=task, reward=reward)
    signature = environment.signature
    rule = signature.goal_rule
    assert rule is not None
    draws = np.random.default_rng(0)
    achieved = draws.normal(0, 0.05, (4, 3, signature.achieved_goal.size)).astype(np.float32)
    desired = draws.normal(0, 0.05, (4, 3, signature.desired_goal.size)).astype(np.float32)
    copy = pickle.loads(pickle.dumps(rule))
    for name in ("reward", "success", "terminated"):
        whole = getattr(rule, name)(achieved, desired)
        assert whole.shape == (4, 3)
        np.testing.assert_array_equal(whole, getattr(copy, name)(achieved, desired))
        for index in np.ndindex(4, 3):
            assert getattr(rule, name)(achieved[index], desired[index]) == whole[index]


def test_declared_parameters_have_a_nominal_value_in_their_range(task: str) -> None:
    environment = robot_task(task=task)
    for declared in (environment.task.parameters, environment.robot.parameters):
        assert declared
        for parameter in declared.values():
            assert parameter.low <= parameter.nominal <= parameter.high
            assert parameter.unit
            assert parameter.description


@pytest.mark.parametrize(("robot", "task_name"), PAIRS)
def test_a_pair_can_be_solved_as_its_expert_shows_and_not_by_chance(robot: str, task_name: str) -> None:
    environment = robot_task(robot, task_name)
    expert = score(environment, expert_policy(environment), episodes=10, seed=1)
    chance = score(environment, random_policy(environment, 1), episodes=10, seed=1)
    assert environment.blow_ups == 0
    environment.close()
    assert expert.success_end >= 0.7
    assert chance.success_end <= 0.3
