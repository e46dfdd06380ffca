"""Statistics over seeds, against scipy and samples worked out by hand."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.integrate import simpson
from scipy.stats import CensoredData, ecdf

from karolos.comparison import aggregates
from karolos.comparison.reaching import kaplan_meier, median_reaching, median_time
from karolos.core.seeding import SeedTree
from karolos.plans.transfer import area_under_curve, forward_transfer, median_time_ratio, ratio_of_means
from karolos.records.intervals import wilson
from karolos.store.density import SMALLEST_BANDWIDTH, bandwidth, kde

ratios = st.lists(st.floats(0, 1), min_size=1, max_size=23)


@given(st.integers(1, 2000), st.floats(0, 1))
def test_wilson_is_what_scipy_says(episodes, share):
    successes = round(share * episodes)
    expected = stats.binomtest(successes, episodes).proportion_ci(method="wilson")
    assert wilson(successes, episodes) == pytest.approx((expected.low, expected.high), abs=1e-12)


@pytest.mark.parametrize(("successes", "episodes"), [(1, 0), (-1, 5), (6, 5)])
def test_wilson_of_nonsense_is_refused(successes, episodes):
    with pytest.raises(ValueError, match="successes"):
        wilson(successes, episodes)


@given(ratios)
def test_density_integrates_to_one_on_the_unit_interval(values):
    found = kde(values)
    assert found.grid[0] == 0
    assert found.grid[-1] == 1
    assert (found.density >= 0).all()
    assert simpson(found.density, x=found.grid) == pytest.approx(1)
    assert 0 <= found.low <= found.high <= 1
    assert found.low <= found.mean <= found.high or len(found.modes) > 1
    assert found.mode in found.modes


@given(ratios)
def test_density_of_failures_mirrors_that_of_successes(values):
    ours, theirs = kde(values), kde([1 - value for value in values])
    assert ours.density == pytest.approx(theirs.density[::-1], rel=1e-3, abs=1e-6)
    assert ours.low == pytest.approx(1 - theirs.high, abs=1e-3)


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_equal_seeds_peak_at_their_value(value):
    found = kde([value] * 5)
    assert found.mode == value
    assert found.modes == (value,)
    assert found.bandwidth == SMALLEST_BANDWIDTH
    assert abs(found.mean - value) < 0.02
    assert found.low > value - 0.05
    assert found.high < value + 0.05


@pytest.mark.parametrize("seeds", [[0.0, 0.05, 0.95, 1.0, 1.0], [0.1] * 3 + [0.9] * 3])
def test_bimodal_seeds_have_two_modes(seeds):
    found = kde(seeds)
    assert len(found.modes) == 2
    assert found.modes[0] < 0.3
    assert found.modes[1] > 0.7


def test_density_of_many_values_approaches_theirs():
    values = np.random.default_rng(0).beta(4, 3, 20_000)
    found = kde(values)
    inside = slice(5, -5)
    assert found.density[inside] == pytest.approx(stats.beta(4, 3).pdf(found.grid)[inside], abs=0.12)
    assert found.mean == pytest.approx(4 / 7, abs=0.01)
    assert (found.low, found.high) == pytest.approx(stats.beta(4, 3).ppf([0.05, 0.95]), abs=0.02)


def test_density_away_from_the_edges_is_scipys():
    values = np.array([0.42, 0.47, 0.5, 0.52, 0.58])
    found = kde(values)
    reference = stats.gaussian_kde(values, bw_method=found.bandwidth / values.std(ddof=1))
    assert found.density == pytest.approx(reference(found.grid), rel=1e-6, abs=1e-9)


def test_bandwidth_is_silvermans_with_a_floor():
    values = np.linspace(0.1, 0.9, 9)
    expected = 0.9 * min(values.std(ddof=1), 0.4 / 1.34) * 9**-0.2
    assert bandwidth(values) == pytest.approx(expected)
    assert bandwidth([0.3]) == bandwidth([1, 1, 1, 1, 0]) == SMALLEST_BANDWIDTH


@pytest.mark.parametrize("values", [[], [1.1], [-0.1], [float("nan")], [0.5, float("inf")]])
def test_values_that_are_no_ratios_are_refused(values):
    with pytest.raises(ValueError, match="between 0 and 1"):
        kde(values)


def generator(seed: int = 0) -> np.random.Generator:
    return SeedTree(seed).generator()


@given(ratios)
def test_inter_quartile_mean_is_the_trimmed_mean_of_scipy(values):
    assert aggregates.iqm(values) == pytest.approx(stats.trim_mean(values, 0.25), abs=1e-12)


def test_many_values_have_the_same_mean_and_interval_in_little_memory():
    values = generator().random(9_000)
    assert aggregates.iqm(values) == pytest.approx(stats.trim_mean(values, 0.25), abs=1e-12)
    assert np.isnan(aggregates.iqm(np.append(values, np.nan)))
    drawn = generator(1).integers(0, 9_000, (aggregates.RESAMPLES, 9_000))
    whole = np.quantile(values[drawn].mean(1), aggregates.LEVELS, method="inverted_cdf")
    tracemalloc.start()
    assert aggregates.paired_interval([values], aggregates.mean, generator(1)) == tuple(whole)
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()


def test_inter_quartile_mean_is_unknown_where_a_value_is():
    found = aggregates.iqm([[0.1, 0.2, 0.3, 0.4], [0.1, np.nan, 0.3, 0.4]])
    assert found == pytest.approx([0.25, np.nan], nan_ok=True)


@given(ratios, ratios)
def test_improvement_is_mann_whitney_u_over_all_pairs(ours, theirs):
    found = aggregates.improvement(ours, theirs)
    u = stats.mannwhitneyu(ours, theirs).statistic
    assert found == pytest.approx(u / (len(ours) * len(theirs)), abs=1e-12)
    assert found + aggregates.improvement(theirs, ours) == pytest.approx(1)


def test_interval_covers_the_mean_of_ten_normal_values_about_as_often_as_it_says():
    draw = generator(1)
    covered = 0
    for _ in range(200):
        low, high = aggregates.paired_interval([draw.normal(0.5, 0.1, 10)], aggregates.mean, draw) or (0, 0)
        covered += low <= 0.5 <= high
    assert 0.82 <= covered / 200 <= 0.97  # a percentile interval of ten values is a little narrow: .90 in theory


def test_kaplan_meier_is_that_of_scipy():
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
        ([1, 2, 3, 4], [1, 1, 1, 1], 2.5),  # one half has reached it until the next one does
        ([1, 9, 9], [1, 0, 0], np.inf),
        ([1, 9, 5], [1, 0, 1], 5),
        ([5, 5], [0, 1], np.inf),  # a run that ends when another one reaches it still counts as observed
        ([2, 5, 7], [0, 1, 1], 6),
    ],
)
def test_median_of_runs_of_which_some_never_got_there(times, reached, median):
    assert median_time(times, reached) == median
    stacked = median_time(np.tile(times, (4, 1)), np.tile(reached, (4, 1)))
    assert stacked.tolist() == [median] * 4


@pytest.mark.parametrize(
    ("places", "median"),
    [
        ([10, 30, None], 30),
        ([10, None, None], None),
        ([10, 20], 15),
        ([10, None], None),
        ([None], None),
        ([7], 7),
        ([], None),
    ],
)
def test_seeds_that_never_reach_a_threshold_count_last(places, median):
    assert median_reaching(places) == median


def test_ratio_of_median_times_is_infinite_zero_or_unknown_where_they_are_infinite():
    assert median_time_ratio([10, 20, 30], [1, 1, 1], [100, 100, 300], [1, 1, 0]) == pytest.approx(0.2)
    assert median_time_ratio([10, 20, 30], [1, 1, 1], [100, 300, 300], [1, 0, 0]) == 0
    assert median_time_ratio([30, 30, 30], [0, 0, 0], [100, 100, 300], [1, 1, 0]) == np.inf
    assert np.isnan(median_time_ratio([30], [0], [100], [0]))


def test_forward_transfer_is_that_of_continual_world():
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


def test_area_is_cut_at_any_step_and_a_single_test_is_its_own_mean():
    assert area_under_curve([100, 300], [0.2, 0.6], 200, 300) == pytest.approx(0.5)
    assert area_under_curve([100, 300], [0.2, 0.6], 100, 500) == pytest.approx((0.4 * 200 + 0.6 * 200) / 400)
    assert area_under_curve([100, 300], [0.2, 0.6], 300, 300) == 0.6


def test_retention_is_a_ratio_of_means_over_paired_seeds():
    assert ratio_of_means([0.9, 0.3], [1.0, 0.5]) == pytest.approx(1.2 / 1.5)
    assert np.isnan(ratio_of_means([0.1], [0.0]))
    assert ratio_of_means(np.ones((3, 2)), np.full((3, 2), 0.5)).tolist() == [2, 2, 2]
