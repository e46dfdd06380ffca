"""Boards, orders, and the best cutting of a board."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting

from karolos.core import Settings
from karolos.core.seeding import Generator

CLEAR, KNOT, CRACK = 0, 1, 2
"""Kinds of cells, from best to worst."""
GRADES = {"clear": CLEAR, "sound": KNOT}
"""The worst kind of cell that a piece of the grade may hold."""

Cells = NDArray[np.int8]


class Order(Settings):
    """A request for pieces of one length and grade."""

    length: int = Setting(ge=1, le=1000, description="cells of a piece")
    grade: str = Setting("clear", pattern="^(clear|sound)$", description="clear: no defect; sound: knots are allowed")
    value: float = Setting(1.0, gt=0, le=1, description="price of a cell in a delivered piece; 1 is the best")
    pieces: int = Setting(
        3, ge=1, le=20, description="largest number of pieces per board; each episode draws from 1 to this"
    )

    @property
    def worst(self) -> int:
        """The worst kind of cell allowed."""
        return GRADES[self.grade]


def draw_board(generator: Generator, length: int, knots: float, cracks: float) -> Cells:
    """A board (length,) with Poisson numbers of knots (1 or 2 cells) and cracks (1 to 3 cells) at uniform places.

    Args:
        generator: of the episode.
        length: cells.
        knots: mean number on a board.
        cracks: mean number on a board.
    """
    board = np.full(length, CLEAR, np.int8)
    for kind, mean, longest in ((KNOT, knots, 2), (CRACK, cracks, 3)):  # cracks last: they replace knots
        for _ in range(generator.poisson(mean)):
            start = int(generator.integers(length))
            board[start : start + int(generator.integers(1, longest + 1))] = kind
    return board


def runs(board: Cells, worst: int) -> NDArray[np.int64]:
    """Number of consecutive cells from each place on that are not worse than `worst`: (length + 1,), the last 0."""
    found = np.zeros(len(board) + 1, np.int64)
    for place in range(len(board) - 1, -1, -1):
        found[place] = found[place + 1] + 1 if board[place] <= worst else 0
    return found


def best_value(board: Cells, orders: Sequence[Order], wanted: Sequence[int]) -> float:
    """The largest value of any cutting of this board, in cells at the best price.

    Exact: dynamic programming from the end of the board over the pieces that are still wanted.
    """
    ahead = {order.worst: runs(board, order.worst) for order in orders}
    best = np.zeros((len(board) + 1, *(count + 1 for count in wanted)))
    for place in range(len(board) - 1, -1, -1):
        best[place] = best[place + 1]
        for axis, order in enumerate(orders):
            if wanted[axis] and ahead[order.worst][place] >= order.length:
                more = np.moveaxis(best[place], axis, 0)[1:]
                fewer = np.moveaxis(best[place + order.length], axis, 0)[:-1]
                np.maximum(more, fewer + order.value * order.length, out=more)
    return float(best[(0, *wanted)])
