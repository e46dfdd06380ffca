"""A greedy policy without foresight, with which learned policies are compared."""

from __future__ import annotations

import numpy as np

from karolos.core import FloatArray

from .cutting import Cutting


def greedy(environment: Cutting, *, per_cell: bool = False) -> FloatArray:
    """The action (1,) that cuts the most valuable piece that fits here, or trims a cell if no piece fits.

    Args:
        environment: before the cut.
        per_cell: prefer the best price per cell to the most valuable piece.
    """
    orders = environment.settings.orders
    fitting = [index for index in range(len(orders)) if environment.fits(index)]
    best = max(
        fitting,
        key=lambda index: orders[index].value * (1 if per_cell else orders[index].length),
        default=len(orders),
    )
    return np.array([best], np.float32)
