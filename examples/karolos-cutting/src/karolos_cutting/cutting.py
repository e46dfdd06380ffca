"""Cutting: a board passes the saw, and each cut makes a piece for an order, or waste."""

from __future__ import annotations

import numpy as np
from pydantic import Field as Setting
from pydantic import model_validator

from karolos.core import Array, Discrete, Environment, Field, FloatArray, Layout, Signature, Step
from karolos.core import Settings as BaseSettings
from karolos.environments.action_set import action_index

from .boards import CRACK, GRADES, KNOT, Order, best_value, draw_board, runs

ORDERS = (
    Order(length=10, grade="clear", value=1.0, pieces=4),
    Order(length=6, grade="clear", value=0.8, pieces=4),
    Order(length=18, grade="sound", value=0.6, pieces=3),
    Order(length=9, grade="sound", value=0.4, pieces=4),
)
COLOURS = np.array([(222, 184, 135), (139, 90, 43), (40, 20, 10)], np.uint8)
"""Colours of clear wood, knots and cracks."""


class Cutting(Environment):
    """What to do: cut a board from its beginning to its end into ordered pieces, around its defects.

    What is randomised: knots and cracks of the board, and the number of pieces of each order.
    What counts as success: the board is cut to its end, and its yield is at least `target` of the best yield for this
    board and these orders. The episode ends (`terminated`) with the board.

    Action: cut a piece for one of the orders, or trim one cell. A piece that does not meet its order is scrap: it has a
    defect that its grade forbids, is too short, or is no longer wanted. Reward: value of the delivered piece / cells of
    the board. The return of an episode is therefore the yield, in [0, 1].
    Observation: for each of the `lookahead` cells after the saw, whether it is a knot, and whether it is a crack or
    beyond the board; for each grade, the cells from here on that meet it, as a share of `lookahead`; for each order,
    whether a piece cut here would be delivered, and the share of its `pieces` that is still wanted; the share of the
    board that is left.
    Source: the second use case of Bitter, Thun, Meisen 2022, "Karolos", section "Industrial Applications", which
    describes the problem. Sizes, prices and defects are invented here.
    """

    class Settings(BaseSettings):
        length: int = Setting(60, ge=2, le=1000, description="cells of a board")
        knots: float = Setting(4.0, ge=0, le=100, description="mean number of knots on a board")
        cracks: float = Setting(2.0, ge=0, le=100, description="mean number of cracks on a board")
        lookahead: int = Setting(26, ge=1, le=1000, description="cells that the scanner sees beyond the saw")
        orders: tuple[Order, ...] = Setting(ORDERS, min_length=1, max_length=6, description="pieces to deliver")
        target: float = Setting(0.9, gt=0, le=1, description="share of the best possible yield that is success")

        @model_validator(mode="after")
        def _orders_fit(self) -> Cutting.Settings:
            longest = max(order.length for order in self.orders)
            if longest > self.length:
                raise ValueError(f"an order of {longest} cells does not fit on a board of {self.length}")
            return self

    def __init__(self, settings: Cutting.Settings) -> None:
        self.settings = settings
        self._actions = Discrete((*(f"cut {order.length} {order.grade}" for order in settings.orders), "trim one cell"))
        dearest = max(order.value * order.length for order in settings.orders)
        self.signature = Signature(
            observation=Layout(
                (
                    Field("knots_ahead", settings.lookahead),
                    Field("cracks_ahead", settings.lookahead),
                    Field("good_ahead", len(GRADES)),
                    Field("deliverable", len(settings.orders)),
                    Field("wanted", len(settings.orders)),
                    Field("board_left", 1),
                )
            ),
            action=self._actions,
            max_steps=settings.length,  # each step takes at least one cell
            reward_range=(0.0, dearest / settings.length),
        )
        self._place = settings.length  # no episode is running

    def reset(self, seed: int) -> Step:
        settings = self.settings
        generator = np.random.Generator(np.random.PCG64(seed))
        self.wanted = [int(generator.integers(1, order.pieces + 1)) for order in settings.orders]
        best = 0.0
        while not best:  # a board without any deliverable piece is drawn again
            self.board = draw_board(generator, settings.length, settings.knots, settings.cracks)
            best = best_value(self.board, settings.orders, self.wanted)
        self.best_yield = best / settings.length
        self.made = 0.0
        """Value delivered so far, in cells at the best price."""
        self._runs = {worst: runs(self.board, worst) for worst in GRADES.values()}
        beyond = np.full(settings.lookahead, CRACK, np.int8)
        self._padded = np.concatenate([self.board, beyond])
        self._place = 0
        return self._step(0.0)

    def fits(self, order: int) -> bool:
        """Whether a piece cut here for this order would be delivered."""
        wanted = self.settings.orders[order]
        return bool(self.wanted[order]) and int(self._runs[wanted.worst][self._place]) >= wanted.length

    def step(self, action: Array) -> Step:
        """Make one cut. Raises ValueError for an unknown action, RuntimeError after the end of the episode."""
        settings = self.settings
        index = action_index(action, self._actions, "Cutting")
        if self._place >= settings.length:
            raise RuntimeError("the episode is over; reset the environment first")
        if index == len(settings.orders):
            self._place += 1
            return self._step(0.0)
        order = settings.orders[index]
        value = order.value * order.length if self.fits(index) else 0.0
        self.wanted[index] -= value > 0
        self.made += value
        self._place = min(self._place + order.length, settings.length)
        return self._step(value / settings.length)

    def _step(self, reward: float) -> Step:
        over = self._place >= self.settings.length
        success = over and self.made / self.settings.length >= self.settings.target * self.best_yield - 1e-9
        no_goal = np.zeros(0, np.float32)
        return Step(self._observe(), no_goal, no_goal, reward, over, False, success)

    def _observe(self) -> FloatArray:
        place, ahead = self._place, self.settings.lookahead
        cells = self._padded[place : place + ahead]
        good = [min(int(found[place]), ahead) / ahead for found in self._runs.values()]
        fitting = [self.fits(order) for order in range(len(self.wanted))]
        left = [count / order.pieces for count, order in zip(self.wanted, self.settings.orders, strict=True)]
        board_left = 1 - place / self.settings.length
        return np.concatenate([cells == KNOT, cells == CRACK, good, fitting, left, [board_left]], dtype=np.float32)

    def render(self, width: int = 640, height: int = 480) -> np.ndarray:
        """The board from left to right; the part that has passed the saw is pale."""
        columns = np.arange(width) * self.settings.length // width
        line = COLOURS[self.board[columns]].copy()
        passed = columns < self._place
        line[passed] = 255 - (255 - line[passed]) // 3
        picture = np.full((height, width, 3), 255, np.uint8)
        picture[height // 3 : 2 * height // 3] = line
        return picture
