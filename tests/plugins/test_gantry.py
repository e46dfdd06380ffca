"""Contracts need the public protocol alone: a robot that is no arm is checked for all that applies to it."""

from typing import Any

import pytest
from support.commands import karolos
from support.gantry import Gantry

from karolos.errors import UsageError
from karolos.plugins.contracts import Candidate, candidate, cases, pairs, results, robots
from karolos.plugins.contracts.checking import of_pair
from karolos.registry import names

GANTRY = Candidate("robots", "gantry", Gantry)


def test_a_gantry_keeps_the_promises_that_apply_to_it():
    found = cases(GANTRY, alone=True) + of_pair(GANTRY, candidate("tasks", "reach"))
    assert {case.promise for case in found} >= {*robots.ANY_ROBOT, *pairs.PROMISES}
    assert [problem for _, problem in results(found) if problem] == []


def test_a_task_that_refuses_a_robot_with_a_reason_breaks_no_promise():
    refused = [task for task in names("tasks") if not candidate("tasks", task).plugin.uses_gripper]
    assert "reach" in refused
    (refusal,) = of_pair(GANTRY, Candidate("tasks", "picky", Picky))
    assert refusal.promise is pairs.the_task_refuses_the_robot
    refusal()


class Picky(candidate("tasks", "reach").plugin):  # type: ignore[misc]  # a class that is known at run time
    """Needs a robot that turns joints."""

    def fit(self, robot: Any) -> None:
        raise UsageError("no joint turns", where="robot")


def fail(self: Any, *_: Any) -> None:
    raise ZeroDivisionError("of my own")


@pytest.mark.parametrize("method", ["build", "act"])
def test_a_check_stops_after_a_broken_basic(monkeypatch, method):
    broken = Candidate("robots", "mine", type("Mine", (Gantry,), {method: fail}))
    monkeypatch.setattr("karolos.plugins.contracts.candidate", lambda *_, **__: broken)
    told = karolos("plugins", "check", "robot", "mine", code=3)
    assert told.out.count("BROKEN") == told.out.count("of my own") == 1
    assert "were not checked" in told.err


def test_a_problem_is_told_once(monkeypatch):
    methods = {"towards": fail, "place_tool": fail, "reset": lambda self, _: self.tool.place(self.home)}
    broken = Candidate("robots", "mine", type("Mine", (Gantry,), methods))
    found = [(str(case), problem) for case, problem in results(cases(broken, alone=True)) if problem]
    assert len(found) > 1
    monkeypatch.setattr("karolos.plugins.contracts.candidate", lambda *_, **__: broken)
    monkeypatch.setattr("karolos.plugins.contracts.cases", lambda one: cases(one, alone=True))
    out = karolos("plugins", "check", "robot", "mine", code=3).out
    assert out.count("BROKEN") == len(found)
    assert out.count("of my own") == 1
    assert "the same problem as of mine-" in out
