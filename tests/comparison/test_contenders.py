from dataclasses import replace

import pytest
from support.compared_runs import SPEC, contender, run

from karolos.comparison import Contender, compare
from karolos.comparison.contenders import cautions, one_per_seed, repeated

A = contender("a", [[50], [60]])


@pytest.mark.parametrize(
    ("other", "warning"),
    [
        ({"spec": SPEC | {"agent": {"name": "ppo"}}}, None),
        ({"versions": {"karolos": "2"}}, "different versions of karolos: a 1; b 2"),
        ({"commit": "def+"}, "made from different code (git commit, + with changes): a abc; b def+"),
        ({"task": "push"}, "they do different tasks: a reach; b push"),
        ({"episodes": 50}, "tests of different numbers of episodes: a 100; b 50"),
        (
            {"spec": SPEC | {"testing": {"interval": 1000, "seed": 7}}},
            "tests on different episodes (testing.seed): a 0; b 7",
        ),
        ({"interval": 500}, "they ended at different steps: a 1,000; b 500"),
    ],
)
def test_what_differs_besides_the_spec_is_told(other, warning):
    usual = {"versions": {"karolos": "1"}, "commit": "abc"}
    one, two = contender("a", [[50], [60]], **usual), contender("b", [[50], [60]], **usual | other)
    assert cautions([one, two]) == ((warning,) if warning else ())


@pytest.mark.parametrize("state", ["running", "stopped", "failed", "lost"])
def test_runs_that_are_not_finished_are_named(state):
    runs = (run(0, [50, 60]), run(1, [50, 60], state=state, steps=2500))
    assert cautions([Contender("a", runs)]) == (f"a: 1 of 2 runs are not finished: reach-s1 {state} at 2,500 steps",)


def test_versions_count_where_they_are_known_and_that_of_an_engine_where_it_was_used():
    assert cautions([contender("a", [[5]], versions={"karolos": "1"}), contender("b", [[5]])]) == ()
    spec = SPEC | {"environment": {"name": "robot_task", "engine": "bullet"}}
    one, two = (
        contender(label, [[5]], spec=spec, versions={"pybullet": "3", "mujoco-core": label}) for label in ("a", "b")
    )
    assert cautions([one, two]) == ()
    used = SPEC | {"environment": {"name": "robot_task", "engine": "mujoco"}}
    other = contender("c", [[5]], spec=used)
    assert cautions([one, other]) == ("different physics engines (environment.engine): a bullet; c mujoco",)
    one, two = (contender(label, [[5]], spec=used, versions={"mujoco-core": label}) for label in ("a", "b"))
    assert cautions([one, two]) == ("different versions of mujoco-core: a a; b b",)


def test_unequal_numbers_of_seeds_are_told_in_every_row():
    rows = compare([A, contender("b", [[50]])]).rows()
    assert [row["warnings"] for row in rows] == [["unequal numbers of seeds: a 2; b 1"]] * 2


def test_runs_of_edited_plugins_are_not_averaged_with_later_ones_and_are_named():
    made = [("a", None), ("b", "old"), ("c", "new"), ("d", "new"), ("e", "old")]
    runs = [
        run(seed, [50], run=name, source=source, created=f"2026-01-0{min(seed, 2)}").summary
        for seed, (name, source) in enumerate(made)
    ]
    runs[4] = replace(runs[4], created="2025")
    assert [one.run for one in one_per_seed(runs).values()] == ["a", "c", "d"]
    (warning,) = repeated("mine", runs)
    assert warning.endswith(": b, e")
