"""The cutting environment: its rewards, its errors, and that observations hold nothing hidden."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from karolos_cutting.boards import CLEAR, CRACK, KNOT, Order, best_value, draw_board, runs
from karolos_cutting.cutting import Cutting
from karolos_cutting.greedy import greedy

from karolos.core import Step, random_actions
from karolos.environments.build import build_environment
from karolos.plugins.contracts import check
from karolos.registry import find, load
from karolos.specification.parts import Part, Recipe

ORDERS = (
    Order(length=3, grade="clear", value=1.0, pieces=2),
    Order(length=2, grade="sound", value=0.5, pieces=2),
)
TRIM = len(ORDERS)


@pytest.fixture
def saw() -> Cutting:
    """At the beginning of the board . . . o . x . . ., a piece of each order wanted."""
    made = Cutting(Cutting.Settings(length=9, knots=0, cracks=0, lookahead=4, orders=ORDERS))
    made.reset(0)
    place(made, [CLEAR, CLEAR, CLEAR, KNOT, CLEAR, CRACK, CLEAR, CLEAR, CLEAR], [1, 1])
    return made


def place(saw: Cutting, board: list[int], wanted: list[int]) -> None:
    """Begin an episode with this board and these orders."""
    saw._place, saw.made = 0, 0.0
    saw.board = np.array(board, np.int8)
    saw.wanted = wanted
    saw.best_yield = best_value(saw.board, ORDERS, wanted) / len(board)
    saw._runs = {worst: runs(saw.board, worst) for worst in saw._runs}
    saw._padded[: len(board)] = saw.board


def cut(saw: Cutting, *orders: int) -> list[Step]:
    return [saw.step(np.array([order], np.float32)) for order in orders]


def test_the_package_is_found_by_its_entry_point_and_made_from_a_recipe() -> None:
    assert find("environments", "cutting").distribution == "karolos-cutting"
    plugin = load("environments", "cutting")
    made = build_environment(Recipe(environment=Part("environments", "cutting", plugin.Settings())))
    assert type(made).__name__ == "Cutting"


def test_it_keeps_what_every_environment_promises() -> None:
    check("environments", "cutting")


def test_a_delivered_piece_pays_its_value_and_the_return_is_the_yield(saw: Cutting) -> None:
    steps = cut(saw, 0, 1, TRIM, 0)
    assert [step.reward for step in steps] == pytest.approx([3 / 9, 1 / 9, 0, 0])
    assert sum(step.reward for step in steps) == pytest.approx(saw.made / 9)
    assert [step.terminated for step in steps] == [False, False, False, True]
    assert steps[-1].success


@pytest.mark.parametrize("orders", [(TRIM, 0), (0, TRIM, 1)], ids=["knot in a clear piece", "crack in a sound piece"])
def test_a_piece_with_a_defect_that_its_grade_forbids_is_scrap(saw: Cutting, orders: tuple[int, ...]) -> None:
    wanted = list(saw.wanted)
    last = cut(saw, *orders)[-1]
    assert last.reward == 0
    assert saw.wanted[orders[-1]] == wanted[orders[-1]], "a scrap piece serves no order"


def test_a_piece_that_nobody_wants_or_that_is_too_short_is_scrap(saw: Cutting) -> None:
    place(saw, [CLEAR] * 9, [1, 0])
    assert [step.reward for step in cut(saw, 0, 0, 1, TRIM)] == pytest.approx([3 / 9, 0, 0, 0])
    saw.reset(0)
    place(saw, [CLEAR] * 9, [2, 2])
    steps = cut(saw, *[TRIM] * 8, 0)
    assert steps[-1].reward == 0
    assert steps[-1].terminated
    with pytest.raises(RuntimeError, match="over"):
        cut(saw, TRIM)


@pytest.mark.parametrize("action", [-1, 3, 0.5])
def test_an_action_that_is_none_of_the_set_is_refused(saw: Cutting, action: float) -> None:
    with pytest.raises(ValueError, match="from 0 to 2"):
        saw.step(np.array([action], np.float32))


def test_the_best_value_is_that_of_trying_every_way_of_cutting() -> None:
    generator = np.random.default_rng(0)
    for _ in range(10):
        board = draw_board(generator, 7, 1.0, 0.5)
        saw = Cutting(Cutting.Settings(length=7, orders=ORDERS, lookahead=4))
        saw.reset(0)
        wanted = [int(count) for count in generator.integers(1, 3, 2)]
        found = 0.0
        for way in product(range(3), repeat=6):  # 3 pieces at most, or 1 and 5 trims
            place(saw, board.tolist(), list(wanted))
            for order in way:
                if cut(saw, order)[0].terminated:
                    break
            found = max(found, saw.made)
        assert best_value(board, ORDERS, wanted) == pytest.approx(found)


def test_the_saw_sees_no_further_than_its_scanner(saw: Cutting) -> None:
    layout = saw.signature.observation
    first = saw._observe()
    assert first[layout.slice("knots_ahead")].tolist() == [0, 0, 0, 1]
    assert first[layout.slice("good_ahead")].tolist() == [0.75, 1.0]
    place(saw, [CLEAR, CLEAR, CLEAR, KNOT, CRACK, CRACK, CRACK, CRACK, CRACK], [1, 1])
    np.testing.assert_array_equal(saw._observe(), first)


def test_no_policy_beats_the_best_yield_and_the_greedy_one_beats_chance() -> None:
    saw = Cutting(Cutting.Settings())
    generator = np.random.default_rng(0)
    yields: dict[str, list[float]] = {"chance": [], "greedy": []}
    for name, found in yields.items():
        for seed in range(40):
            over = bool(saw.reset(seed).terminated)
            while not over:
                action = greedy(saw) if name == "greedy" else random_actions(saw.signature, 1, generator)[0]
                over = bool(saw.step(action).terminated)
            assert saw.made / saw.settings.length <= saw.best_yield + 1e-9
            found.append(saw.made / saw.settings.length)
    assert np.mean(yields["greedy"]) > np.mean(yields["chance"]) + 0.1


def test_an_order_longer_than_the_board_is_refused() -> None:
    with pytest.raises(ValueError, match="does not fit on a board of 5"):
        Cutting.Settings(length=5)
