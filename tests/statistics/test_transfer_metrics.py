"""Metrics of transfer beside tables worked by hand and the definitions of their papers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import CensoredData, ecdf

from karolos.statistics.transfer import (
    area_under_curve,
    forward_transfer,
    kaplan_meier,
    median_time,
    median_time_ratio,
    ratio_of_means,
)

WEEKS = [6, 6, 6, 6, 7, 9, 10, 10, 11, 13, 16, 17, 19, 20, 22, 23, 25, 32, 32, 34, 35]
RELAPSED = [1, 1, 1, 0, 1, 0, 1, 0, 0, 1, 1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0]
"""Weeks of remission of 21 patients under 6-MP (Freireich et al. 1963), the textbook example; 0: censored."""
TABLE = {6: 0.857, 7: 0.807, 10: 0.753, 13: 0.690, 16: 0.627, 22: 0.538, 23: 0.448}
"""The product-limit table of these, worked by hand: 18/21, times 16/17, 14/15, 11/12, 10/11, 6/7, 5/6."""


def test_kaplan_meier_is_the_table_worked_by_hand() -> None:
    shuffled = np.random.default_rng(0).permutation(len(WEEKS))
    times, remaining = kaplan_meier(np.array(WEEKS)[shuffled], np.array(RELAPSED)[shuffled])
    for week, fraction in TABLE.items():
        assert remaining[np.flatnonzero(times == week)[-1]] == pytest.approx(fraction, abs=5e-4)
    assert median_time(WEEKS, RELAPSED) == 23


def test_kaplan_meier_is_that_of_scipy() -> None:
    generator = np.random.default_rng(1)
    for size in (1, 2, 5, 40):
        times = generator.integers(1, 12, size).astype(float)
        reached = generator.random(size) < 0.6
        theirs = ecdf(CensoredData(times[reached], right=times[~reached])).sf
        ours, remaining = kaplan_meier(times, reached)
        for time, fraction in zip(theirs.quantiles, theirs.probabilities, strict=True):
            assert remaining[np.flatnonzero(ours == time)[-1]] == pytest.approx(fraction)


@pytest.mark.parametrize(
    ("times", "reached", "median"),
    [
        ([3, 1, 2], [1, 1, 1], 2),
        ([1, 2, 3, 4], [1, 1, 1, 1], 2),  # one half has reached it
        ([1, 9, 9], [1, 0, 0], np.inf),
        ([1, 9, 5], [1, 0, 1], 5),
        ([5, 5], [0, 1], 5),  # a run that ends when another one reaches it still counts as observed
        ([2, 5, 7], [0, 1, 1], 5),
    ],
)
def test_median_of_runs_of_which_some_never_got_there(times: list[int], reached: list[int], median: float) -> None:
    assert median_time(times, reached) == median
    stacked = median_time(np.tile(times, (4, 1)), np.tile(reached, (4, 1)))
    assert stacked.tolist() == [median] * 4


def test_ratio_of_median_times_is_infinite_zero_or_unknown_where_they_are_infinite() -> None:
    assert median_time_ratio([10, 20, 30], [1, 1, 1], [100, 100, 300], [1, 1, 0]) == pytest.approx(0.2)
    assert median_time_ratio([10, 20, 30], [1, 1, 1], [100, 300, 300], [1, 0, 0]) == 0
    assert median_time_ratio([30, 30, 30], [0, 0, 0], [100, 100, 300], [1, 1, 0]) == np.inf
    assert np.isnan(median_time_ratio([30], [0], [100], [0]))


def test_forward_transfer_is_that_of_continual_world() -> None:
    """AUC_i is the mean success over the training steps of task i, by Riemann sums over a fine grid."""
    steps = np.array([0.0, 100.0, 200.0, 400.0])
    tuned, scratch = np.array([0.5, 0.9, 1.0, 1.0]), np.array([0.0, 0.1, 0.6, 0.8])
    grid = np.linspace(0, 400, 400_001)
    auc, auc_scratch = (np.interp(grid, steps, curve).mean() for curve in (tuned, scratch))
    areas = [[area_under_curve(steps, curve, 0, 400)] for curve in (tuned, scratch)]
    assert np.ravel(areas) == pytest.approx([auc, auc_scratch], abs=1e-5)
    assert forward_transfer(*areas) == pytest.approx((auc - auc_scratch) / (1 - auc_scratch), abs=1e-5)
    assert forward_transfer([1.0, 1.0], [0.2, 0.4]) == 1
    assert forward_transfer([0.1], [0.4]) == pytest.approx(-0.5)
    assert np.isnan(forward_transfer([1.0], [1.0]))


def test_area_is_cut_at_any_step_and_a_single_test_is_its_own_mean() -> None:
    assert area_under_curve([100, 300], [0.2, 0.6], 200, 300) == pytest.approx(0.5)
    assert area_under_curve([100, 300], [0.2, 0.6], 100, 500) == pytest.approx((0.4 * 200 + 0.6 * 200) / 400)
    assert area_under_curve([100, 300], [0.2, 0.6], 300, 300) == 0.6


def test_retention_is_a_ratio_of_means_over_paired_seeds() -> None:
    assert ratio_of_means([0.9, 0.3], [1.0, 0.5]) == pytest.approx(1.2 / 1.5)
    assert np.isnan(ratio_of_means([0.1], [0.0]))
    assert ratio_of_means(np.ones((3, 2)), np.full((3, 2), 0.5)).tolist() == [2, 2, 2]
