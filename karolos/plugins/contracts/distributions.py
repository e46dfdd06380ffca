"""Promises of every distribution."""

from __future__ import annotations

import math

import numpy as np

from .case import Candidate, Promises, demand

DRAWS = 1000
PROMISES = Promises()


@PROMISES
def values_are_finite_floats(one: Candidate) -> None:
    """`draw` returns a finite Python float."""
    found = _drawn(one, 0)
    demand(all(type(value) is float for value in found), "a value is not a Python float")
    demand(all(map(math.isfinite, found)), "a value is not finite")


@PROMISES
def the_generator_alone_determines_the_values(one: Candidate) -> None:
    """The same generator gives the same values; another gives others, unless there is only one value."""
    first = _drawn(one, 1)
    demand(first == _drawn(one, 1), "the same generator gives other values: draw from the given generator")
    demand(len(set(first)) == 1 or first != _drawn(one, 2), "another generator gives the same values")


def _drawn(one: Candidate, seed: int) -> list[float]:
    made = one.plugin(one.settled())
    generator = np.random.Generator(np.random.PCG64(seed))
    return [made.draw(generator) for _ in range(DRAWS)]
