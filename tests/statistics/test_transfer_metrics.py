"""Metrics of transfer beside tables worked by hand and the definitions of their papers."""

import numpy as np
import pytest

from karolos.statistics.transfer import area_under_curve, forward_transfer, median_time_ratio, ratio_of_means


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
