"""The report of a matrix: its numbers beside the tests in the run folders, and its page."""

import json
import re
from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from support.transfer_samples import run_matrix

from karolos.core.seeding import SeedTree
from karolos.plans.matrix import Matrix
from karolos.plans.matrix_report import (
    TransferReport,
    _paired,
    cells_table,
    matrix_page,
    matrix_table,
    metric_map,
    notes,
    over_targets,
    transfer_figures,
    transfer_report,
    variants_table,
)
from karolos.plans.transfer import forward_transfer
from karolos.records.intervals import wilson

pytestmark = pytest.mark.xdist_group("transfer")


@pytest.fixture(scope="module")
def report(undisturbed: Matrix) -> TransferReport:
    return transfer_report(undisturbed)


def test_numbers_are_those_of_the_folders(undisturbed, report):
    (cell,) = [one for one in report.cells if (one.source, one.target) == ("fast", "slow")]
    tests = undisturbed.zero_shot["fast", "slow"]
    zero = [tests[seed].success_end for seed in (0, 1)]
    own = [tests[seed].own.success_end for seed in (0, 1)]
    shot = cell.estimates["zero_shot"]
    assert (shot.value, shot.low, shot.high) == (np.mean(zero), min(zero), max(zero))
    if sum(map(float, own)):
        assert cell.estimates["retention"].value == pytest.approx(np.mean(zero) / np.mean(own))
    gains, ends, areas = [], [], []
    for seed in (0, 1):
        tuned, scratch = undisturbed.fine_tuned["fast", "slow"][seed], undisturbed.sources["slow"][seed]
        curves = [{test.steps: test.success_end for test in run.tests()} for run in (tuned, scratch)]
        assert [list(curve) for curve in curves] == [[20, 40, 60, 80], [40, 80, 120, 160]]
        gains.append(curves[0][40] - curves[1][40])
        finals = [run.final() for run in (tuned, scratch)]
        ends.append(finals[0]["last"].success_end - finals[1]["last"].success_end)
        areas.append([(curves[0][40] + 2 * curves[0][60] + curves[0][80]) / 4, (curves[1][40] + curves[1][80]) / 2])
    tuned_area, scratch_area = np.mean(areas, axis=0)
    assert cell.estimates["jump_start"].value == pytest.approx(np.mean(gains))
    assert cell.estimates["asymptote"].value == pytest.approx(np.mean(ends))
    assert cell.estimates["forward_transfer"].value == pytest.approx((tuned_area - scratch_area) / (1 - scratch_area))


def test_the_diagonal_is_the_policy_at_home_and_has_nothing_to_compare(report):
    own = [one for one in report.cells if one.source == one.target]
    assert len(own) == 2
    for cell in own:
        assert set(cell.estimates) == {"zero_shot"}


def test_rows_are_json_with_wilson_intervals_of_each_run_and_the_cost_of_the_source(report):
    rows = json.loads(json.dumps(report.rows(), allow_nan=False))
    assert [(row["source"], row["target"]) for row in rows] == [
        (source, target) for source in ("fast", "slow") for target in ("fast", "slow")
    ]
    row = rows[1]
    assert row["zero_shot"]["wilson"] == [list(wilson(round(10 * one), 10)) for one in row["zero_shot"]["each"]]
    assert row["source_cost"]["steps"] == 160
    assert row["steps_to_threshold"]["of"] == row["scratch"]["steps_to_threshold"]["of"] == 2
    assert 0 <= row["floor"] <= 1
    assert row["ceiling"] is None  # a toy has no expert


def test_rows_say_which_seeds_and_how_many_pairs_count(undisturbed):
    pair = ("fast", "slow")
    less = copy(undisturbed)
    less.zero_shot = {**undisturbed.zero_shot, pair: {1: undisturbed.zero_shot[pair][1]}}
    less.sources = {**undisturbed.sources, "slow": {0: undisturbed.sources["slow"][0]}}
    row = transfer_report(less).rows()[1]
    assert (row["seeds"], len(row["zero_shot"]["each"]), row["fine_tuned_seeds"]) == ([1], 1, [0, 1])
    assert (row["jump_start"]["pairs"], row["jump_start"]["alone"]) == (1, 1)


def test_a_pair_without_a_value_of_its_own_is_counted_and_noted(report):
    gained = _paired([[0.9, 0.5], [1.0, 1.0], [0.8, 0.6]], forward_transfer, SeedTree(0))
    assert gained is not None
    assert (gained.pairs, gained.alone) == (3, 2)
    cells = [replace(one, estimates={**one.estimates, "forward_transfer": gained}) for one in report.cells[1:2]]
    said = "Forward transfer, pairs that alone have a value: fast to slow 2 of 3"
    assert said in notes(replace(report, cells=tuple(cells)))


def test_a_source_that_has_lost_its_tests_is_left_out_with_a_warning(undisturbed, tmp_path):
    folder = undisturbed.sources["fast"][0]
    tests = folder.path / "tests.jsonl"
    moved = tests.rename(tmp_path / "tests.jsonl")
    try:
        report = transfer_report(undisturbed)
    finally:
        moved.rename(tests)
    assert report.warnings == (f"{folder.id} has lost its tests and is left out",)
    assert [[*variant.runs] for variant in report.variants] == [[1], [0, 1]]


def test_the_page_holds_a_heat_map_for_each_metric_and_every_run(report):
    text = matrix_page(report, *transfer_figures(report))
    for word in (
        "Zero-shot success",
        "Forward transfer",
        "Learning on slow",
        "Continual World",
        "line-fast-to-slow-s1-",
    ):
        assert word in text
    assert not re.search(r"<script|https?://(?!www\.w3\.org)", text)
    drawing = metric_map(report, "zero_shot")
    rows = [label.get_text() for label in drawing.axes.get_yticklabels()]
    assert rows == ["fast", "slow", "expert", "random"]
    assert len(variants_table(report).rows) == 2


def test_references_are_trained_every_other_variant_counts_once_and_nothing_is_fine_tuned(tmp_path):
    overrides = ["transfer.sources=[fast]", "transfer.references=[slower]", "transfer.fine_tune=null", "seeds=[0]"]
    overrides += ["transfer.variants.slower={environment.speed: 0.1}", "transfer.modes=[zero_shot, scratch]"]
    runs, outcome, started = run_matrix(tmp_path, *overrides, "training.steps=40")
    tests = ["(line-fast-to-slow)", "(line-fast-to-slower)"]
    assert (outcome.exit_code, started) == (0, ["line-fast", "line-slower", *tests])
    found = transfer_report(runs)
    variants = [replace(one, refused="too heavy") if one.label == "slow" else one for one in found.variants]
    found = replace(found, variants=tuple(variants))
    [table] = over_targets(found)
    zero = [runs.zero_shot["fast", to][0].success_end for to in ("slow", "slower")]
    row, own, floor = table.rows
    assert (row[0], row[1], row[5]) == ("fast", "2", "slow: too heavy")
    assert float(row[2].split()[0]) == pytest.approx(np.mean(zero), abs=1e-3)
    assert (own[:2], floor[:2]) == (("own training", "2"), ("random actions", "3"))
    assert {one.estimates["zero_shot"].kind for one in found.cells if one.estimates} == {"wilson"}
    assert matrix_table(found, "zero_shot").columns == ["from", "to fast", "to slow", "to slower"]
    assert len(cells_table(found).rows) == 2
    assert any("Wilson" in line for line in notes(found))
    page = matrix_page(found, *transfer_figures(found))
    assert "Over arms" in page
    assert "Learning" not in page
    assert found.rows()[1]["refused"] == "too heavy"
