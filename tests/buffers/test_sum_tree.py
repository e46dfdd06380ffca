"""The sum tree against a plain array."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from karolos.buffers.priority import SumTree

numbers = st.floats(0, 1e6, allow_subnormal=False).map(lambda value: 0.0 if value < 1e-6 else value)


@st.composite
def writes(draw: st.DrawFn) -> tuple[int, list[tuple[list[int], list[float]]]]:
    size = draw(st.integers(1, 40))
    index = st.integers(0, size - 1)
    pairs = st.lists(st.tuples(index, numbers), min_size=1, max_size=12, unique_by=lambda pair: pair[0])
    made = draw(st.lists(pairs, min_size=1, max_size=6))
    return size, [([place for place, _ in batch], [value for _, value in batch]) for batch in made]


def written(history):
    """A tree and an array with the same numbers."""
    size, batches = history
    tree, plain = SumTree(size), np.zeros(size)
    for places, values in batches:
        tree[np.array(places)] = np.array(values)
        plain[places] = values
    return tree, plain


@given(writes(), st.integers(0, 39))
def test_numbers_are_what_was_written_last_and_sums_are_those_of_all_and_of_the_numbers_in_front(history, place):
    tree, plain = written(history)
    np.testing.assert_array_equal(tree[np.arange(plain.size)], plain)
    np.testing.assert_allclose(tree.total, plain.sum(), rtol=1e-12)
    place %= plain.size
    np.testing.assert_allclose(tree.before(place), plain[:place].sum(), rtol=1e-12)


@given(writes(), st.lists(st.floats(0, 1, exclude_max=True), min_size=1, max_size=20))
def test_find_gives_the_number_under_which_the_mass_falls_and_never_one_that_is_0(history, shares):
    tree, plain = written(history)
    if plain.sum() == 0:
        return
    masses = np.array(shares) * tree.total
    found = tree.find(masses)
    assert (plain[found] > 0).all()
    ends = np.cumsum(plain)
    slack = 1e-9 * tree.total
    assert (masses <= ends[found] + slack).all()
    assert (masses >= ends[found] - plain[found] - slack).all()


def test_the_tree_depends_on_its_numbers_alone_not_on_how_they_were_written():
    generator = np.random.default_rng(0)
    values, masses = generator.random(1000), generator.random(500)
    whole, rewritten, parts = SumTree(1000), SumTree(1000), SumTree(1000)
    whole[np.arange(1000)] = values
    for _ in range(200):
        rewritten[generator.integers(0, 1000, 50)] = generator.random(50)
    rewritten[np.arange(1000)] = values
    for start in range(0, 1000, 50):
        parts[np.arange(start, start + 50)] = values[start : start + 50]
    for tree in (rewritten, parts):
        assert tree.total == whole.total
        np.testing.assert_array_equal(tree.find(masses * whole.total), whole.find(masses * whole.total))
        assert [tree.before(place) for place in range(0, 1000, 7)] == [
            whole.before(place) for place in range(0, 1000, 7)
        ]
