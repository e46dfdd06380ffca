"""Statistics over seeds."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from karolos.core.seeding import SeedTree
from karolos.statistics import aggregates

RATIO = st.floats(0, 1, allow_nan=False)


def generator(seed: int = 0) -> np.random.Generator:
    return SeedTree(seed).generator()


@given(st.lists(RATIO, min_size=1, max_size=23))
def test_inter_quartile_mean_is_the_trimmed_mean_of_scipy(values: list[float]) -> None:
    assert aggregates.iqm(values) == pytest.approx(stats.trim_mean(values, 0.25), abs=1e-12)


def test_many_values_have_the_same_mean_and_interval_in_little_memory() -> None:
    values = generator().random(9_000)
    assert aggregates.iqm(values) == pytest.approx(stats.trim_mean(values, 0.25), abs=1e-12)
    assert np.isnan(aggregates.iqm(np.append(values, np.nan)))
    drawn = generator(1).integers(0, 9_000, (aggregates.RESAMPLES, 9_000))
    whole = np.quantile(values[drawn].mean(1), aggregates.LEVELS, method="inverted_cdf")
    tracemalloc.start()
    assert aggregates.paired_interval([values], aggregates.mean, generator(1)) == tuple(whole)
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()


def test_inter_quartile_mean_is_unknown_where_a_value_is() -> None:
    found = aggregates.iqm([[0.1, 0.2, 0.3, 0.4], [0.1, np.nan, 0.3, 0.4]])
    assert found == pytest.approx([0.25, np.nan], nan_ok=True)


@given(st.lists(RATIO, min_size=1, max_size=9), st.lists(RATIO, min_size=1, max_size=9))
def test_improvement_is_mann_whitney_u_over_all_pairs(ours: list[float], theirs: list[float]) -> None:
    found = aggregates.improvement(ours, theirs)
    u = stats.mannwhitneyu(ours, theirs).statistic
    assert found == pytest.approx(u / (len(ours) * len(theirs)), abs=1e-12)
    assert found + aggregates.improvement(theirs, ours) == pytest.approx(1)


@pytest.mark.parametrize(
    ("seeds", "worth"), [(1, "none"), (4, "none"), (5, "approximate"), (9, "approximate"), (10, "usual")]
)
def test_intervals_are_given_for_five_seeds_or_more(seeds: int, worth: str) -> None:
    values = np.linspace(0.2, 0.8, seeds)
    found = aggregates.paired_interval([values], aggregates.mean, generator())
    assert aggregates.reliability(seeds) == worth
    assert (found is None) == (worth == "none")
    assert (aggregates.improvement_interval(values, values, generator()) is None) == (worth == "none")


def test_interval_covers_the_mean_of_ten_normal_values_about_as_often_as_it_says() -> None:
    draw = generator(1)
    covered = 0
    for _ in range(200):
        low, high = aggregates.paired_interval([draw.normal(0.5, 0.1, 10)], aggregates.mean, draw) or (0, 0)
        covered += low <= 0.5 <= high
    assert 0.82 <= covered / 200 <= 0.97  # a percentile interval of ten values is a little narrow: .90 in theory


def test_interval_is_the_same_for_the_same_generator() -> None:
    values = [0.1, 0.5, 0.6, 0.7, 0.9]
    assert aggregates.paired_interval([values], aggregates.iqm, generator()) == aggregates.paired_interval(
        [values], aggregates.iqm, generator()
    )


def test_profile_falls_from_all_to_none() -> None:
    found = aggregates.profile([0.2, 0.5, 1.0], [0, 0.2, 0.21, 0.6, 1.0])
    assert found.tolist() == pytest.approx([1, 1, 2 / 3, 1 / 3, 1 / 3])
