"""When runs reach a threshold, of which some end before, beside tables worked by hand and SciPy."""

import numpy as np
import pytest
from scipy.stats import CensoredData, ecdf

from karolos.statistics.reaching import first_reaching, kaplan_meier, median_reaching, median_time

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
        ([1, 2, 3, 4], [1, 1, 1, 1], 2.5),  # one half has reached it until the next one does
        ([1, 9, 9], [1, 0, 0], np.inf),
        ([1, 9, 5], [1, 0, 1], 5),
        ([5, 5], [0, 1], np.inf),  # a run that ends when another one reaches it still counts as observed
        ([2, 5, 7], [0, 1, 1], 6),
    ],
)
def test_median_of_runs_of_which_some_never_got_there(times: list[int], reached: list[int], median: float) -> None:
    assert median_time(times, reached) == median
    stacked = median_time(np.tile(times, (4, 1)), np.tile(reached, (4, 1)))
    assert stacked.tolist() == [median] * 4


def test_first_reaching_is_the_first_test_at_or_over_the_threshold() -> None:
    assert first_reaching([0.1, 0.5, 0.4, 0.9], [10, 20, 30, 40], 0.5) == 20
    assert first_reaching([0.1, 0.4], [10, 20], 0.5) is None


@pytest.mark.parametrize(
    ("places", "median"),
    [([10, 30, None], 30), ([10, None, None], None), ([10, 20], 15), ([10, None], None), ([None], None), ([7], 7)],
)
def test_seeds_that_never_reach_a_threshold_count_last(places: list[float | None], median: float | None) -> None:
    assert median_reaching(places) == median
