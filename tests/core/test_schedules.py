"""Schedules: what is due depends on counts alone."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from karolos.core.schedules import Every, Linear, Ratio

growing = st.lists(st.integers(0, 40), min_size=1, max_size=50)


@given(st.integers(1, 30), growing)
def test_every_is_due_once_for_each_call_that_passes_a_multiple(interval, increments):
    every, count = Every(interval), 0
    for increment in increments:
        before, count = count, count + increment
        assert every(count) == (count // interval > before // interval)


def test_every_is_not_due_at_zero():
    assert not Every(5)(0)


@given(st.fractions(0, 4, max_denominator=64), growing)
def test_ratio_never_owes_a_whole_one_and_never_runs_ahead(ratio, increments):
    schedule, count, made = Ratio(float(ratio)), 0, 0
    for increment in increments:
        count += increment
        made += schedule(count)
        assert made <= count * float(ratio) < made + 1


@given(st.floats(-5, 5), st.floats(-5, 5), st.integers(0, 1000), st.integers(0, 3000))
def test_linear_goes_evenly_from_start_to_end_and_stays_there(start, end, over, count):
    found = Linear(start, end, over)(count)
    share = min(count / over, 1) if over else 1
    assert found == pytest.approx(start + (end - start) * share, abs=1e-9)
    assert Linear(start, end, over)(over) == end
    assert over == 0 or Linear(start, end, over)(0) == start
