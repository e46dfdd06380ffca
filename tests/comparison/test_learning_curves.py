import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.compared_runs import contender, run

from karolos.comparison import aggregates
from karolos.comparison.curves import POINTS, along, densities, learning_curve
from karolos.core.seeding import SeedTree
from karolos.records.intervals import wilson
from karolos.store.density import integral


def generator() -> np.random.Generator:
    return SeedTree(0).generator()


def test_seeds_tested_at_the_same_steps_are_not_interpolated():
    at, values = along([run(0, [10, 20]), run(1, [30, 60])], "steps", "any")
    assert at.tolist() == [1000, 2000]
    assert values.tolist() == [[0.1, 0.3], [0.2, 0.6]]


def test_seeds_tested_elsewhere_are_interpolated_where_all_are_known():
    at, values = along([run(0, [0, 100]), run(1, [0, 0, 40, 80], interval=750)], "steps", "any")
    assert at.tolist() == [1000, 1500, 2000, 2250, 3000]
    assert values[:, 0].tolist() == [0, 0.5, 1, 1, 1]  # finished: it keeps what it has
    assert values[:, 1] == pytest.approx([0, 0, 0.4 * 2 / 3, 0.4, 0.8])


def test_curve_ends_where_an_unfinished_run_does():
    at, values = along([run(0, [0, 50, 90]), run(1, [0, 40], state="lost")], "steps", "any")
    assert at.tolist() == [1000, 2000]
    assert values[-1].tolist() == [0.5, 0.4]


def test_over_time_each_seed_counts_at_its_own_pace():
    at, values = along([run(0, [0, 100], rate=100), run(1, [0, 100], rate=50)], "seconds", "any")
    assert (at[0], at[-1], at.size) == (20, 40, POINTS)
    assert values[0].tolist() == [1.0, 0.0]
    assert values[-1].tolist() == [1.0, 1.0]


@pytest.mark.parametrize("axis", ["steps", "seconds"])
def test_one_test_is_a_curve_of_one_point(axis):
    at, values = along([run(0, [70]), run(1, [80])], axis, "any")  # type: ignore[arg-type]
    assert (at.size, values.tolist()) == (1, [[0.7, 0.8]])


def test_band_of_one_run_is_wilsons_and_of_its_return_nothing_and_of_few_seeds_their_range():
    curve = learning_curve([run(0, [10, 90])], "steps", "any", aggregates.mean, generator())
    assert list(zip(curve.low, curve.high, strict=True)) == [wilson(10, 100), wilson(90, 100)]
    curve = learning_curve([run(0, [10, 90])], "steps", "return", aggregates.mean, generator())
    assert curve.middle.tolist() == curve.low.tolist() == curve.high.tolist() == [-190, -110]
    curve = learning_curve([run(0, [10]), run(1, [40]), run(2, [30])], "steps", "any", aggregates.mean, generator())
    assert (curve.low[0], curve.high[0], curve.middle[0]) == (0.1, 0.4, pytest.approx(0.8 / 3))


@given(st.lists(st.lists(st.integers(0, 100), min_size=3, max_size=3), min_size=5, max_size=8))
def test_band_lies_around_the_statistic_and_within_the_seeds(curves):
    runs = [run(seed, curve) for seed, curve in enumerate(curves)]
    curve = learning_curve(runs, "steps", "any", aggregates.mean, generator())
    values = np.array(curves).T / 100
    assert (curve.low >= values.min(axis=1) - 1e-12).all()
    assert (curve.high <= values.max(axis=1) + 1e-12).all()
    assert (curve.low <= curve.middle + 1e-12).all()
    assert (curve.middle <= curve.high + 1e-12).all()


def test_density_of_seeds_that_agree_peaks_where_they_are_at_each_test():
    at, found = densities(contender("a", [[0, 50, 100]] * 5), "any")
    assert at.tolist() == [1000, 2000, 3000]
    assert [one.mode for one in found] == [0.0, 0.5, 1.0]
    assert [integral(one.density) for one in found] == pytest.approx([1, 1, 1])
