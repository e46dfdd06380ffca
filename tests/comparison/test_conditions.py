"""Tests under other settings, and measures episode by episode, reach the figures of a comparison."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from support import toy_runs as toys

from karolos.comparison import compare, conditions, gather
from karolos.core.seeding import SeedTree
from karolos.evaluation.zero_shot import zero_shot_test
from karolos.records import transfer_results
from karolos.report.comparison_figures import condition_figures, measure_figures


def test_success_over_a_setting_and_the_spread_of_measures_are_drawn(tmp_path: Path) -> None:
    folder = toys.run_of(toys.REACH, tmp_path)
    done = zero_shot_test(folder, ["task.threshold=0.2"], checkpoint="last", episodes=4)
    succeeded = replace(done.result, end=(True, True, True, False))
    transfer_results.add(folder, replace(done, result=succeeded))
    transfer_results.add(folder, replace(done, overrides=("task.threshold=0.3", "robot.name=ur5")))
    transfer_results.add(folder, replace(done, overrides=("task.reward=dense",)))
    transfer_results.add(folder, replace(done, overrides=("task.threshold=0.4",), randomized=True))

    contender = gather(None, [folder.record().summary], "one")
    found = conditions(contender, SeedTree(0))["task.threshold"]
    own = folder.spec()["task"]["threshold"]
    assert {value: one.value for value, one in found.items()} == {own: done.own.success_end, 0.2: 0.75}
    assert list(found) == sorted(found)
    assert found[0.2].kind == "wilson"

    compared = compare([contender])
    [drawing] = condition_figures(compared)
    assert [text for _, text in drawing.parts.values() if text.startswith("one at 0.2: 0.750")]
    spread = next(one for one in measure_figures(compared) if one.name == "measure_final_distance_spread")
    final = folder.final()
    assert final is not None
    values = final.last.measures["final_distance"]["values"]
    line = spread.axes.get_lines()[0]
    for x, share in zip(line.get_xdata(), line.get_ydata(), strict=True):
        assert share == pytest.approx(sum(one is not None and one <= x for one in values) / len(values))
