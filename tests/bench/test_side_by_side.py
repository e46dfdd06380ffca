import pytest

from bench.side_by_side import Row, beside, take_turns


def test_contestants_take_turns_in_alternating_order_and_know_the_turn():
    calls: list[tuple[str, int]] = []

    def contestant(name: str, turn: int) -> int:
        calls.append((name, turn))
        return 10 * turn

    measured = take_turns({name: lambda turn, name=name: contestant(name, turn) for name in "ab"}, turns=3)
    assert calls == [("a", 0), ("b", 0), ("b", 1), ("a", 1), ("a", 2), ("b", 2)]
    assert measured == {"a": [0, 10, 20], "b": [0, 10, 20]}


def test_a_row_of_turns_has_medians_and_the_ratios_of_the_turns():
    row = beside("sac", [2.0, 8.0, 3.0], "updates/s", "other", [1.0, 2.0, 6.0]).dump()
    assert (row["value"], row["peer_value"]) == (3.0, 2.0)
    assert (row["ratio_min"], row["ratio"], row["ratio_max"]) == (0.5, 2.0, 4.0)


def test_a_row_without_turns_has_the_ratio_of_its_figures():
    assert Row("check", 3.0, "s", "other", 2.0).dump()["ratio"] == pytest.approx(1.5)
    assert Row("check", 3.0, "s").dump()["ratio"] is None
