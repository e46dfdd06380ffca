"""The sum tree against a plain array."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from karolos.buffers.sum_tree import SumTree

numbers = st.floats(0, 1e6, allow_subnormal=False).map(lambda value: 0.0 if value < 1e-6 else value)


@st.composite
def writes(draw: st.DrawFn) -> tuple[int, list[tuple[list[int], list[float]]]]:
    size = draw(st.integers(1, 40))
    index = st.integers(0, size - 1)
    pairs = st.lists(st.tuples(index, numbers), min_size=1, max_size=12, unique_by=lambda pair: pair[0])
    made = draw(st.lists(pairs, min_size=1, max_size=6))
    return size, [([place for place, _ in batch], [value for _, value in batch]) for batch in made]


@given(writes())
def test_total_is_the_sum_and_numbers_are_what_was_written_last(history):
    size, batches = history
    tree, plain = SumTree(size), np.zeros(size)
    for places, values in batches:
        tree[np.array(places)] = np.array(values)
        plain[places] = values
    np.testing.assert_array_equal(tree[np.arange(size)], plain)
    np.testing.assert_allclose(tree.total, plain.sum(), rtol=1e-12)


@given(writes(), st.lists(st.floats(0, 1, exclude_max=True), min_size=1, max_size=20))
def test_find_gives_the_number_under_which_the_mass_falls_and_never_one_that_is_0(history, shares):
    size, batches = history
    tree, plain = SumTree(size), np.zeros(size)
    for places, values in batches:
        tree[np.array(places)] = np.array(values)
        plain[places] = values
    if plain.sum() == 0:
        return
    masses = np.array(shares) * tree.total
    found = tree.find(masses)
    assert (plain[found] > 0).all()
    ends = np.cumsum(plain)
    slack = 1e-9 * tree.total
    assert (masses <= ends[found] + slack).all()
    assert (masses >= ends[found] - plain[found] - slack).all()


@given(writes(), st.integers(0, 40))
def test_before_is_the_sum_of_the_numbers_in_front(history, place):
    size, batches = history
    tree, plain = SumTree(size), np.zeros(size)
    for places, values in batches:
        tree[np.array(places)] = np.array(values)
        plain[places] = values
    place = min(place, size - 1)
    np.testing.assert_allclose(tree.before(place), plain[:place].sum(), rtol=1e-12)


def test_the_tree_depends_on_its_numbers_alone_not_on_how_they_came():
    generator = np.random.default_rng(0)
    one, values = SumTree(1000), generator.random(1000)
    for _ in range(200):
        one[generator.integers(0, 1000, 50)] = generator.random(50)
    one[np.arange(1000)] = values
    other = SumTree(1000)
    other[np.arange(1000)] = values
    np.testing.assert_array_equal(one._nodes, other._nodes)


def test_many_numbers_at_once_are_the_same_as_few_at_a_time():
    places, values = np.arange(100, 1000), np.random.default_rng(0).random(900)
    whole, parts = SumTree(1024), SumTree(1024)
    whole[places] = values
    for start in range(0, 900, 50):
        parts[places[start : start + 50]] = values[start : start + 50]
    np.testing.assert_array_equal(whole._nodes, parts._nodes)
    np.testing.assert_allclose(whole.total, values.sum(), rtol=1e-12)
