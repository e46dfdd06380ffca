"""Promises of every task that do not depend on the robot. They are checked with the given robot."""

from __future__ import annotations

import pickle

import numpy as np

from .case import Candidate, Promises, demand, demand_same
from .joined import joined

HEADINGS = ("What to do:", "What is randomised:", "What counts as success:")
REWARDS = ("sparse", "dense")
PROMISES = Promises()


@PROMISES
def the_docstring_says_what_to_do_what_is_randomised_and_what_counts(_: Candidate, task: Candidate) -> None:
    """The class's docstring has the headings "What to do:", "What is randomised:" and "What counts as success:"."""
    for heading in HEADINGS:
        demand(heading in (task.plugin.__doc__ or ""), f'the docstring lacks "{heading}"')


@PROMISES
def the_goal_rule_survives_pickling_and_works_on_leading_axes(robot: Candidate, task: Candidate) -> None:
    """The goal rule can be pickled, and its results for arrays of goals are those for each goal."""
    known = task.plugin.Settings.model_fields
    for reward in REWARDS if "reward" in known else (None,):
        with joined(robot, task, **({} if reward is None else {"reward": reward})) as environment:
            signature = environment.signature
        rule = signature.goal_rule
        if rule is None:
            raise AssertionError("the task has no goal rule")
        draws = np.random.default_rng(0)
        achieved = draws.normal(0, 0.05, (4, 3, signature.achieved_goal.size)).astype(np.float32)
        desired = draws.normal(0, 0.05, (4, 3, signature.desired_goal.size)).astype(np.float32)
        copy = pickle.loads(pickle.dumps(rule))
        for name in ("reward", "success", "terminated"):
            whole = getattr(rule, name)(achieved, desired)
            demand(whole.shape == (4, 3), f"{name} of goals (4, 3, n) has the shape {whole.shape} instead of (4, 3)")
            demand_same(whole, getattr(copy, name)(achieved, desired), f"{name} of a pickled rule")
            for index in np.ndindex(4, 3):
                demand_same(getattr(rule, name)(achieved[index], desired[index]), whole[index], f"{name} of one goal")


@PROMISES
def declared_parameters_have_a_nominal_value_in_their_range(robot: Candidate, task: Candidate) -> None:
    """Every parameter of task and robot has a unit, a description and a nominal value within its range."""
    with joined(robot, task) as environment:
        for who, declared in ((task.name, environment.task.parameters), (robot.name, environment.robot.parameters)):
            demand(declared, f"{who} declares no parameter")
            for name, one in declared.items():
                demand(
                    one.low <= one.nominal <= one.high,
                    f"{name}: the nominal value {one.nominal} is not in {one.low} .. {one.high}",
                )
                demand(one.unit and one.description, f"{name} has no unit or no description")
