from __future__ import annotations

from karolos.benchmarks.experts import Case, all_cases, measure
from karolos.plugins.inspection import floor
from karolos.registry import names


def test_the_floor_is_that_of_karolos_inspect() -> None:
    (row,) = measure([Case("panda", "reach")], episodes=30, seed=1)
    found = floor("panda", "reach", episodes=30, seed=1)
    assert (row.peer_value, row.peer_low, row.peer_high) == (found.success_end, found.low, found.high)


def test_figures_are_the_same_with_one_process_and_with_two() -> None:
    cases = [Case("panda", "reach"), Case("iiwa", "push", "joint")]
    assert list(measure(cases, episodes=3, jobs=1)) == list(measure(cases, episodes=3, jobs=2))


def test_all_pairs_that_go_together_are_measured() -> None:
    cases, refusals = all_cases()
    assert len(cases) + len(refusals) == len(names("robots")) * len(names("tasks"))
    assert {(case.robot, case.task) for case in cases} >= {(robot, "pick_place") for robot in names("robots")}
