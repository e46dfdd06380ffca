"""What a sawyer without foresight does: the bar for a policy that learns."""

from __future__ import annotations

import numpy as np

from karolos.core import FloatArray

from .cutting import Cutting


def greedy(environment: Cutting, *, per_cell: bool = False) -> FloatArray:
    """The action (1,) for the most valuable piece that fits here; trims a cell where none does.

    Args:
        per_cell: the piece of the best price per cell instead of the most valuable one.
    """
    orders = environment.settings.orders
    fitting = [index for index in range(len(orders)) if environment.fits(index)]
    best = max(
        fitting,
        key=lambda index: orders[index].value * (1 if per_cell else orders[index].length),
        default=len(orders),
    )
    return np.array([best], np.float32)
