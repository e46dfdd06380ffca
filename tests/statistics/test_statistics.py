import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.integrate import simpson

from karolos.statistics.density import SMALLEST_BANDWIDTH, bandwidth, integral, kde
from karolos.statistics.intervals import wilson

ratios = st.lists(st.floats(0, 1), min_size=1, max_size=20)


@given(st.integers(1, 2000), st.floats(0, 1))
def test_wilson_is_what_scipy_says(episodes: int, share: float) -> None:
    successes = round(share * episodes)
    expected = stats.binomtest(successes, episodes).proportion_ci(method="wilson")
    assert wilson(successes, episodes) == pytest.approx((expected.low, expected.high), abs=1e-12)


@pytest.mark.parametrize(("successes", "episodes"), [(1, 0), (-1, 5), (6, 5)])
def test_wilson_of_nonsense_is_refused(successes: int, episodes: int) -> None:
    with pytest.raises(ValueError, match="successes"):
        wilson(successes, episodes)


@given(ratios)
def test_density_integrates_to_one_on_the_unit_interval(values: list[float]) -> None:
    found = kde(values)
    assert found.grid[0] == 0
    assert found.grid[-1] == 1
    assert (found.density >= 0).all()
    assert simpson(found.density, x=found.grid) == pytest.approx(1)
    assert 0 <= found.low <= found.high <= 1
    assert found.low <= found.mean <= found.high or len(found.modes) > 1
    assert found.mode in found.modes


@given(ratios)
def test_density_of_failures_mirrors_that_of_successes(values: list[float]) -> None:
    ours, theirs = kde(values), kde([1 - value for value in values])
    assert ours.density == pytest.approx(theirs.density[::-1], rel=1e-3, abs=1e-6)
    assert ours.low == pytest.approx(1 - theirs.high, abs=1e-3)


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_equal_seeds_peak_at_their_value(value: float) -> None:
    found = kde([value] * 5)
    assert found.mode == value
    assert found.modes == (value,)
    assert found.bandwidth == SMALLEST_BANDWIDTH
    assert abs(found.mean - value) < 0.02
    assert found.low > value - 0.05
    assert found.high < value + 0.05


@pytest.mark.parametrize("seeds", [[0.0, 0.05, 0.95, 1.0, 1.0], [0.1] * 3 + [0.9] * 3])
def test_bimodal_seeds_have_two_modes(seeds: list[float]) -> None:
    found = kde(seeds)
    assert len(found.modes) == 2
    assert found.modes[0] < 0.3
    assert found.modes[1] > 0.7


def test_density_of_many_values_approaches_theirs() -> None:
    values = np.random.default_rng(0).beta(4, 3, 20_000)
    found = kde(values)
    inside = slice(5, -5)
    assert found.density[inside] == pytest.approx(stats.beta(4, 3).pdf(found.grid)[inside], abs=0.12)
    assert found.mean == pytest.approx(4 / 7, abs=0.01)
    assert (found.low, found.high) == pytest.approx(stats.beta(4, 3).ppf([0.05, 0.95]), abs=0.02)


def test_density_away_from_the_edges_is_scipys() -> None:
    values = np.array([0.42, 0.47, 0.5, 0.52, 0.58])
    found = kde(values)
    reference = stats.gaussian_kde(values, bw_method=found.bandwidth / values.std(ddof=1))
    assert found.density == pytest.approx(reference(found.grid), rel=1e-6, abs=1e-9)


def test_bandwidth_is_silvermans_with_a_floor() -> None:
    values = np.linspace(0.1, 0.9, 9)
    expected = 0.9 * min(values.std(ddof=1), 0.4 / 1.34) * 9**-0.2
    assert bandwidth(values) == pytest.approx(expected)
    assert bandwidth([0.3]) == bandwidth([1, 1, 1, 1, 0]) == SMALLEST_BANDWIDTH


@given(st.lists(st.floats(-5, 5), min_size=3, max_size=21).filter(lambda heights: len(heights) % 2 == 1))
def test_integral_is_simpsons(heights: list[float]) -> None:
    assert integral(heights) == pytest.approx(simpson(heights, dx=1 / (len(heights) - 1)), abs=1e-9)


@pytest.mark.parametrize("values", [[], [1.1], [-0.1], [float("nan")], [0.5, float("inf")]])
def test_values_that_are_no_ratios_are_refused(values: list[float]) -> None:
    with pytest.raises(ValueError, match="between 0 and 1"):
        kde(values)


def test_even_number_of_points_is_refused() -> None:
    with pytest.raises(ValueError, match="odd number"):
        integral([1, 2])
