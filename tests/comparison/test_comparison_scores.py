"""Numbers of a comparison against samples worked out by hand."""

import json
import math
from dataclasses import replace
from typing import Any

import pytest
from support.compared_runs import CURVES, SPEC, contender, run

from karolos.comparison import Contender, Estimate, compare
from karolos.comparison.scores import estimate as estimate_of
from karolos.core.seeding import SeedTree
from karolos.errors import UsageError
from karolos.plans.transfer import median_time_ratio
from karolos.records.intervals import wilson
from karolos.records.run_records import RunRecord
from karolos.report.tables import compared_measures_table, estimate, verdict


def test_one_run_has_the_wilson_interval_of_its_last_test_and_none_of_its_return():
    [scores] = compare([contender("a", [[10, 80]])]).scores
    assert scores.any == Estimate(0.8, *wilson(80, 100), "wilson")
    assert scores.end == Estimate(0.4, *wilson(40, 100), "wilson")
    assert scores.returns == Estimate(-120.0, -120.0, -120.0, "none")
    assert scores.density is None


@pytest.mark.parametrize(
    ("seeds", "kind"), [(2, "range"), (4, "range"), (5, "approximate"), (9, "approximate"), (10, "bootstrap")]
)
def test_two_seeds_and_more_have_their_range_and_five_a_bootstrap_interval(seeds, kind):
    [scores] = compare([contender("a", [[10 * seed] for seed in range(seeds)])]).scores
    assert scores.any.kind == kind
    assert 0 <= scores.any.low < scores.any.value < scores.any.high <= (seeds - 1) / 10
    assert kind != "range" or (scores.any.low, scores.any.high) == (0, (seeds - 1) / 10)


def test_measures_are_means_over_seeds_and_unknown_where_a_seed_does_not_know():
    def known(seed: int, force: float, time: float | None) -> RunRecord:
        about = {"peak_force": ("N", "smaller", force), "time": ("s", "larger", time)}
        measures = {name: dict(zip(("unit", "better", "mean"), one, strict=True)) for name, one in about.items()}
        return run(seed, [10], measures=measures)

    comparison = compare([Contender("a", (known(0, 20.0, None), known(1, 40.0, 2.0))), contender("old", [[10]])])
    [scores, old] = comparison.scores
    assert scores.measures == {"peak_force": Estimate(30.0, 20.0, 40.0, "range"), "time": None}
    assert old.measures == {}
    assert compared_measures_table(comparison).rows == [("peak_force, N", "30.0 (20.0 to 40.0)", "-")]
    assert comparison.rows()[0]["measures"]["time"] == {
        "unit": "s", "better": "larger", "value": None, "seeds": [None, 2.0]
    }  # fmt: skip


def test_ratios_of_seeds_that_never_reach_a_threshold_are_infinite_and_count():
    def found(times: list[int], reached: list[int], scratch_reached: list[int]) -> str:
        rows = [times, reached, [400, 410, 420, 430, 440][: len(times)], scratch_reached]
        return estimate(estimate_of(rows, median_time_ratio, SeedTree(0)))

    assert found([100, 200, 300, 1000, 1000], [1, 1, 1, 0, 0], [1] * 5) == "0.714 ~[0.250, \N{INFINITY}]"
    assert found([100, 200, 1000], [1, 1, 0], [1] * 3) == "0.488 (0.250 to \N{INFINITY})"
    assert found([100, 200, 1000], [1, 1, 0], [1, 0, 0]) == "0.000 (0.000 to 0.250)"
    assert found([100, 200, 300, 1000, 1000], [1, 1, 1, 0, 0], [1, 1, 1, 0, 0]) == "0.714"  # a third is unknown


def test_inter_quartile_mean_leaves_out_a_quarter_at_each_end():
    [scores] = compare([contender("a", CURVES)], "any").scores
    assert scores.iqm.value == pytest.approx((0.85 + 0.90 + 0.95) / 3)
    assert scores.any.value == pytest.approx((0.85 + 0.90 + 0.95 + 1.0) / 5)


def test_steps_and_time_to_a_ratio_are_medians_with_those_that_never_got_there_counted_last():
    [scores] = compare([contender("a", CURVES)], "any").scores
    half, most = scores.reaching
    assert (half.ratio, half.reached, half.seeds, half.steps, half.seconds) == (0.5, 4, 5, 3000, 30)
    assert (most.ratio, most.reached, most.seeds, most.steps, most.seconds) == (0.9, 3, 5, 3000, 30)
    [scores] = compare([contender("a", [[90], [90], [0], [0]])], "any").scores  # half of them never get there
    assert [(one.reached, one.steps, one.seconds) for one in scores.reaching] == [(2, None, None)] * 2


def test_runs_are_compared_at_a_number_of_steps():
    long, short = contender("a", CURVES), contender("b", [[0, 60], [0, 70]])
    compared = compare([long, short], "any", at=2050)
    assert [scores.any.value for scores in compared.scores] == [pytest.approx(0.34), pytest.approx(0.65)]
    assert [scores.steps for scores in compared.scores] == [2000, 2000]
    assert compared.scores[0].best_end is None
    assert compared.scores[0].reaching[1].reached == 0
    assert not any("ended at different steps" in warning for warning in compared.warnings)
    assert [(row["at"], row["updates_per_second"]) for row in compared.rows()] == [(2050, None)] * 2


def test_steps_far_from_every_test_of_a_run_are_refused():
    with pytest.raises(UsageError, match=r"--at: .* has no test near 3,000 steps; its nearest is at 2,000"):
        compare([contender("a", CURVES), contender("b", [[0, 60]])], "any", at=3000)


def test_success_at_the_end_is_what_counts():
    comparison = compare([contender("a", [[100], [80]]), contender("b", [[100], [90]])])
    assert comparison.metric == "end"
    assert comparison.scores[0].iqm.value == pytest.approx(0.45)
    assert comparison.scores[0].reaching[0].reached == 1
    assert comparison.scores[1].improvement.value == (0.5 + 0 + 1 + 1) / 4


def test_two_modes_of_the_seeds_are_told():
    [scores] = compare([contender("a", [[0]] * 5 + [[100]] * 5)], "any").scores
    assert scores.density.modes == (0.0, 1.0)


def test_only_parameters_that_differ_are_listed():
    other = SPEC | {"seeds": [7], "agent": {"name": "sac", "learning_rate": 1e-4, "hidden": [256, 256], "more": None}}
    comparison = compare([contender("a", [[1]]), contender("b", [[1]], spec=other)])
    rows = comparison.rows()
    assert rows[0]["parameters"] == {"agent.learning_rate": 1e-3}
    assert rows[1]["parameters"] == {"agent.learning_rate": 1e-4, "agent.more": None}


def test_rows_are_json_and_the_same_each_time():
    def text() -> list[str]:
        rows = compare([contender("a", CURVES), contender("b", CURVES[::-1])], "any").rows()
        return [json.dumps(row, allow_nan=False) for row in rows]

    assert text() == text()
    row: dict[str, Any] = json.loads(text()[1])
    assert row["n"] == 5
    assert row["steps_to_90"] == {"median": 3000, "reached": 3, "of": 5}
    assert row["updates_per_second"] == 50.0
    assert row["improvement"]["probability"] == 0.5


def test_cost_is_the_mean_over_runs():
    runs = (run(0, [1], rate=100), run(1, [1, 1], rate=50))
    [scores] = compare([Contender("a", runs)]).scores
    assert (scores.steps, scores.seconds) == (1500, 25)


def test_returns_are_compared_seed_by_seed_without_thresholds_and_densities():
    first, second = compare([contender("a", [[50], [60]]), contender("b", [[60], [70]])], "return").scores
    assert (first.returns.value, first.returns.low, first.returns.high) == (-145.0, -150.0, -140.0)
    assert first.iqm.value == -145.0
    assert first.end.value == 0.275
    assert (first.improvement, second.improvement.kind) == (None, "none")  # two seeds
    assert second.improvement.value == (1 + 0.5 + 1 + 1) / 4, "ties count half"
    assert (first.reaching, first.density, first.over_steps) == ((), None, None)


def test_a_return_that_is_not_finite_makes_its_experiment_unknown_and_never_the_best():
    diverged = run(0, [90], name="bad", final=True, mean_return=None)
    bad = Contender("bad", (diverged, *contender("bad", [[91], [92], [93], [94]]).runs[1:]))
    compared = compare([contender("a", [[50]] * 5), bad, contender("c", [[60]] * 5)], "return")
    assert math.isnan(compared.scores[1].returns.value)
    assert math.isnan(compared.scores[1].iqm.value)
    assert "bad: no finite return, so no mean is known: bad-s0" in compared.warnings
    assert verdict(compared) == (
        "Highest mean of return: c, -140.000 ~[-140.000, -140.000]. Better than a: c. "
        "Not comparable with a, because a return is not finite: bad."
    )


def test_where_success_is_undefined_returns_are_what_counts():
    undefined = contender("a", [[50], [60]], has_success=False)
    comparison = compare([undefined, contender("b", [[60], [70]])])
    assert comparison.metric == "return"
    assert (comparison.scores[0].end, comparison.scores[0].any) == (None, None)
    row = comparison.rows()[0]
    assert (row["success_end"], row["mean_return"]["seeds"]) == (None, [-150.0, -140.0])
    assert "steps_to_90" not in row
    with pytest.raises(UsageError, match="the environment of a does not define success"):
        compare([undefined], "end")


def test_a_test_without_a_success_counts_as_none_where_another_test_has_one():
    one, other = run(0, [50]), run(0, [60], has_success=False)
    mixed = replace(one, tests=(other.tests[0], *one.tests))
    assert mixed.values("any") == (0.0, 0.5)
