from __future__ import annotations

import json

from karolos_cli.bench import app
from support.commands import call


def test_rows_say_how_expert_and_random_policy_do_in_the_same_episodes() -> None:
    code, out, err = call(app, "experts", "--pair", "ur5/reach", "--pair", "panda/push", "--episodes", "4", "--json")
    assert code == 0, err
    reach, push = (json.loads(line) for line in out.splitlines())
    assert (reach["case"], push["case"]) == ("ur5 reach", "panda push")
    for row in (reach, push):
        assert (row["benchmark"], row["peer"], row["episodes"]) == ("experts", "random policy", 4)
        assert row["low"] <= row["value"] <= row["high"]
        assert row["peer_low"] <= row["peer_value"] <= row["peer_high"]
        assert row["any"] >= row["value"] >= 0.75
    assert 1 <= reach["steps"] < push["steps"] <= 50


def test_a_table_has_one_line_per_pair() -> None:
    code, out, _ = call(app, "experts", "--pair", "panda/reach", "--episodes", "2", "--control", "joint")
    assert code == 0
    assert out.splitlines()[0].split() == [
        *("pair", "end", "interval", "any", "steps", "random", "random_interval", "episodes")
    ]
    assert out.splitlines()[1].startswith("panda reach joint")


def test_what_is_no_pair_is_refused() -> None:
    for pair, message in (
        ("panda", "is not a pair"),
        ("panda/", "is not a pair"),
        ("panda/raech", "did you mean 'reach'"),
    ):
        code, _, err = call(app, "experts", "--pair", pair)
        assert code == 2
        assert message in err
