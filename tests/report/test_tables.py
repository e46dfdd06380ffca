from __future__ import annotations

import io
from dataclasses import replace

import pytest
from karolos_cli.output import rich_table
from rich.console import Console

from karolos.records.results import TestCounts, TestResult
from karolos.records.run_records import RunSummary
from karolos.report.tables import (
    Table,
    clean,
    count,
    duration,
    facts_table,
    flatten,
    runs_table,
    success,
    table_of_tests,
)

RUN = RunSummary(
    run="reach-s0-1",
    experiment="abc",
    seed=0,
    state="finished",
    steps=20_000,
    seconds=47.21,
    success_any=0.97,
    success_end=0.9,
    steps_to_95=6000,
    seconds_to_95=12.0,
    name="reach",
    episodes=100,
    environment="robot_task",
    robot="panda",
    task="reach",
    agent="sac",
    attempt=1,
    error=None,
    created="2026-01-01",
    updated="2026-01-01",
    folder="runs/reach-s0-1",
)


def shown(table: Table) -> str:
    stream = io.StringIO()
    Console(file=stream, width=200, force_terminal=True, color_system=None).print(rich_table(table))
    return stream.getvalue()


def test_run_is_shown_with_the_interval_of_its_success() -> None:
    text = shown(runs_table([RUN]))
    parts = (
        "reach-s0-1",
        "finished",
        "20,000",
        "47.2 s",
        "success end",
        "0.90 [0.83, 0.94]",
        "0.97",
        "steps to .95 end",
        "6,000",
        "12.0 s",
    )
    for part in parts:
        assert part in text


def test_run_without_a_test_is_shown() -> None:
    empty = dict.fromkeys(("success_any", "success_end", "steps_to_95", "seconds_to_95", "episodes"), None)
    assert shown(runs_table([replace(RUN, **empty)])).count(" - ") == 6


def test_returns_stand_alone_where_nothing_defines_success() -> None:
    empty = dict.fromkeys(("success_any", "success_end", "steps_to_95", "seconds_to_95"), None)
    run = replace(RUN, **empty, mean_return=-1234.567, best_return=-130.0)
    table = runs_table([run])
    assert [*table.columns[-2:], *table.rows[0][-2:]] == ["return", "best return", "-1,234.57", "-130.00"]
    assert not any("success" in name or ".95" in name for name in table.columns)
    both = runs_table([run, replace(RUN, mean_return=-3.0)])
    assert both.columns[-1] == "return"
    assert [row[-1] for row in both.rows] == ["-1,234.57", "-3.00"]
    assert both.rows[0][both.columns.index("success end")] == "-"
    tests = table_of_tests([TestCounts(1000, 100.0, 20, None, None, None, -12.5)])
    assert list(tests.columns) == ["steps", "time", "return", "episodes"]


def test_test_is_shown_with_both_ways_to_count() -> None:
    text = shown(table_of_tests([TestCounts(1000, 100.0, 20, 18, 0, 3, -12.5)]))
    for part in ("1,000", "1 min 40 s", "0.90 [0.70, 0.97]", "0.00 [0.00, 0.16]", "20", "3", "-12.50"):
        assert part in text
    assert "within" not in text


def test_test_is_shown_with_how_many_ended_near_their_goal_where_that_is_known() -> None:
    flags = (True, False, False, False)
    far = TestResult(1000, 100.0, flags, flags, flags, (0.0,) * 4, (9,) * 4, (0.04, 0.09, 0.2, float("inf")))
    tests = [TestCounts(steps, steps / 10, 4, 1, 1, 0, 0.0) for steps in (1000, 2000)]
    text = shown(table_of_tests(tests, [far]))
    for part in ("end within 0.05 / 0.10 / 0.25 m", "0.25 / 0.50 / 0.75"):
        assert part in text


@pytest.mark.parametrize("evil", ["\x1b[2Jx", "\x9b31mx", "a\rb", "a\nb", "\u202ereversed", "\x07", "\ud800"])
def test_text_from_a_file_cannot_steer_the_terminal(evil: str) -> None:
    assert clean(evil).isprintable()
    run = replace(RUN, run=evil, state=evil)
    text = shown(runs_table([run])) + shown(facts_table({evil: evil}))
    assert evil not in text
    assert all(sign.isprintable() or sign == "\n" for sign in text)


def test_markup_in_a_text_is_shown_as_it_is() -> None:
    assert "[red]x[/red]" in shown(facts_table({"error": "[red]x[/red]", "none": None}))
    assert "none" not in shown(facts_table({"none": None}))


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (None, "-"),
        (0.04, "0.0 s"),
        (99.94, "99.9 s"),
        (99.96, "1 min 40 s"),
        (119.6, "2 min 00 s"),
        (3599.7, "1 h 00 min"),
        (90_000, "25 h 00 min"),
    ],
)
def test_durations_read_as_people_say_them(seconds: float | None, text: str) -> None:
    assert duration(seconds) == text


def test_numbers_that_are_not_there_are_dashes() -> None:
    assert (count(None), success(None, None), success(0.5, 0)) == ("-", "-", "-")


def test_nested_spec_becomes_key_paths() -> None:
    spec = {"agent": {"name": "sac", "nets": {"hidden": [256, 256]}}, "robot": None, "empty": {}, "on": True}
    assert dict(flatten(spec)) == {
        "agent.name": "sac",
        "agent.nets.hidden": "[256, 256]",
        "robot": "null",
        "empty": "{}",
        "on": "true",
    }
