"""Random places for goals and objects."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..core import FloatArray
from ..core.seeding import Generator
from ..errors import RunError
from ..simulation.interface import Box

ATTEMPTS = 1000
GOAL_COLOUR = (0.16, 0.74, 0.32, 0.5)
"""Of the marker that shows a goal."""


def place(generator: Generator, box: Box, accepted: Callable[[FloatArray], bool], what: str) -> FloatArray:
    """A point (3,) in m, uniform among those in the box that are accepted.

    Raises:
        RunError: none of 1000 points was; `what` says what was to be placed.
    """
    for _ in range(ATTEMPTS):
        point = generator.uniform(box.low, box.high).astype(np.float32)
        if accepted(point):
            return point
    raise RunError(
        f"found no place for {what} in {ATTEMPTS} attempts",
        hint=f"the box is {box.low} to {box.high} m; a smaller threshold or another range leaves more room",
    )
