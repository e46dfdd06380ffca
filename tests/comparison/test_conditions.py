"""Tests under other settings, and measures episode by episode, reach the figures of a comparison."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support import toy_runs as toys
from support.compared_runs import SPEC, contender
from support.run_samples import result

from karolos.comparison import compare, gather
from karolos.comparison.conditions import Condition, conditions
from karolos.core.seeding import SeedTree
from karolos.evaluation.zero_shot import zero_shot_test
from karolos.records import RunFolder
from karolos.records.evaluation import Evaluation
from karolos.report.comparison_figures import condition_figures, measure_figures
from karolos.system.files import Lines

Reads = Callable[[dict[int, list[Evaluation]]], Condition]


@pytest.fixture
def read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Reads:
    """Over a setting: the condition of three runs that have these tests."""

    def found(tests: dict[int, list[Evaluation]]) -> Condition:
        monkeypatch.setattr(RunFolder, "open", staticmethod(lambda folder: RunFolder(Path(folder))))
        monkeypatch.setattr(RunFolder, "transfers", lambda self: Lines(tuple(tests.get(int(self.id[-1]), ())), ()))
        spec = SPEC | {"task": {"name": "reach", "threshold": 0.05}}
        [condition] = conditions(contender("a", [[10]] * 3, spec=spec), SeedTree(0)).values()
        return condition

    return found


def of(value: float, successes: int, *, episodes: int = 20, setting: str = "task.threshold", **about: Any) -> Any:
    """A test with so many successes, whose policy has success in all episodes but two at its own value."""
    test = result(100, successes, episodes, end=successes, has_success=about.pop("known", True))
    own = Evaluation(100, 1.0, episodes, episodes - 2, episodes - 2, 0, 0.0)
    about = {"checkpoint": "best", "sha256": "a", "seed": 7} | about
    return replace(test, overrides=(f"{setting}={value}",), own=own, **about)


def test_only_tests_that_belong_together_stand_in_one_line(read):
    both = {run: [of(0.01, 5), of(0.02, 10 + run)] for run in (0, 1)}
    probe = [of(0.03, 3, episodes=3), of(0.01, 0, checkpoint="last"), of(0.01, 0, seed=8)]
    again = [of(0.02, 20, sha256="of an earlier policy"), *both[0], of(0.04, 0, known=False)]
    found = read({0: [*again, *probe], 1: both[1]})
    values = {value: one.value for value, one in found.success.items()}
    assert values == pytest.approx({0.01: 0.25, 0.02: 0.525, 0.05: 0.9})
    assert found.notes == (
        "Only tests of best on 20 episodes of seed 7 are shown.",
        "2 of 3 runs were tested at each of these values.",
    )


def test_every_value_rests_on_the_same_runs(read):
    both = [of(0.01, 5), of(0.02, 20), of(0.04, 20)]
    found = read({0: [of(0.01, 5)], 1: [*both, of(0.03, 20)], 2: both})
    assert {value: one.value for value, one in found.success.items()} == {0.01: 0.25, 0.02: 1.0, 0.04: 1.0, 0.05: 0.9}
    assert found.notes == ("2 of 3 runs were tested at each of these values.", "Not every run was tested at 0.03.")


def test_a_parameter_of_the_world_is_shown_without_its_nominal_value(read):
    found = read({run: [of(-5, 10, setting="task.gravity")] for run in (0, 1, 2)})
    assert {value: one.value for value, one in found.success.items()} == {-5: 0.5}
    assert found.notes == ("Success at the nominal value, which the spec does not name, is left out.",)


def test_success_over_a_setting_and_the_spread_of_measures_are_drawn(tmp_path):
    folder = toys.run_of(toys.REACH, tmp_path)
    done = zero_shot_test(folder, ["task.threshold=0.2"], checkpoint="last", episodes=4)
    folder.add_transfer(replace(done, end=(True, True, True, False), successes_end=3))
    folder.add_transfer(replace(done, overrides=("task.threshold=0.3", "robot.name=ur5")))
    folder.add_transfer(replace(done, overrides=("task.reward=dense",)))
    folder.add_transfer(replace(done, overrides=("task.threshold=0.4",), randomized=True))

    one = gather(None, [folder.record().summary], "one")
    found = conditions(one, SeedTree(0))["task.threshold"].success
    own = folder.spec()["task"]["threshold"]
    assert {value: one.value for value, one in found.items()} == {own: done.own.success_end, 0.2: 0.75}
    assert list(found) == sorted(found)
    assert found[0.2].kind == "wilson"

    compared = compare([one])
    [drawing] = condition_figures(compared)
    assert [text for _, text in drawing.parts.values() if text.startswith("one at 0.2: 0.750")]
    spread = next(one for one in measure_figures(compared) if one.name == "measure_final_distance_spread")
    values = folder.final()["last"].measures["final_distance"]["values"]
    line = spread.axes.get_lines()[0]
    for x, share in zip(line.get_xdata(), line.get_ydata(), strict=True):
        assert share == pytest.approx(sum(one is not None and one <= x for one in values) / len(values))
