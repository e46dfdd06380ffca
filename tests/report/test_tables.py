import io
import math
from dataclasses import replace

import pytest
from karolos_cli.output import rich_table
from rich.console import Console
from support.compared_runs import run

from karolos.records.evaluation import Evaluation
from karolos.report.tables import (
    Table,
    count,
    csv_text,
    duration,
    evaluations_table,
    facts_table,
    run_facts,
    runs_table,
    settings_table,
    success,
)

TESTED = {"success_any": 0.97, "success_end": 0.9, "steps_to_95": 6000, "seconds_to_95": 12.0}
RUN = run(0, [97], interval=20_000, **TESTED).summary


def row(table: Table) -> dict[str, str]:
    """The first row by column."""
    return dict(zip(table.columns, table.rows[0], strict=True))


def test_run_is_shown_with_the_interval_of_its_success():
    assert row(runs_table([RUN])) == {
        "run": "reach-s0",
        "state": "finished",
        "steps": "20,000",
        "time": "3 min 20 s",
        "total": "0.0 s",
        "success end": "0.90 [0.83, 0.94]",
        "any": "0.97",
        "steps to .95 end": "6,000",
        "time to .95 end": "12.0 s",
    }


def test_columns_without_a_value_are_left_out_and_returns_stand_alone_where_nothing_defines_success():
    untested = replace(RUN, **dict.fromkeys(TESTED, None))
    assert list(runs_table([untested]).columns) == ["run", "state", "steps", "time", "total"]
    returns = replace(untested, mean_return=-1234.567, best_return=-130.0)
    assert row(runs_table([returns])).items() >= {"return": "-1,234.57", "best return": "-130.00"}.items()
    both = row(runs_table([returns, replace(RUN, mean_return=-3.0)]))
    assert (both["return"], both["success end"], "best return" in both) == ("-1,234.57", "-", False)
    tests = evaluations_table([Evaluation(1000, 100.0, 20, None, None, None, -12.5)])
    assert list(tests.columns) == ["steps", "time", "return", "episodes"]


def test_test_is_shown_with_both_ways_to_count_and_how_many_ended_near_their_goal():
    counts = Evaluation(1000, 100.0, 20, 18, 0, 3, -12.5)
    expected = {
        "steps": "1,000",
        "time": "1 min 40 s",
        "success end": "0.00 [0.00, 0.16]",
        "success any": "0.90 [0.70, 0.97]",
        "return": "-12.50",
        "episodes": "20",
        "solved at reset": "3",
    }
    assert row(evaluations_table([counts])) == expected
    table = evaluations_table([replace(counts, distances=(0.04, 0.09, 0.2, math.inf) * 5), counts])
    assert row(table) == expected | {"end within 0.05 / 0.10 / 0.25 m": "0.25 / 0.50 / 0.75"}
    assert table.rows[1][-1] == "-"


def test_markup_in_a_text_is_shown_as_it_is_and_facts_without_a_value_are_not():
    stream = io.StringIO()
    Console(file=stream, width=200).print(rich_table(facts_table({"error": "[red]x[/red]", "none": None})))
    assert "[red]x[/red]" in stream.getvalue()
    assert "none" not in stream.getvalue()


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
def test_durations_read_as_people_say_them(seconds, text):
    assert duration(seconds) == text


def test_numbers_that_are_not_there_are_dashes():
    assert (count(None), success(None, None), success(0.5, 0)) == ("-", "-", "-")


def test_nested_spec_becomes_key_paths():
    spec = {"agent": {"name": "sac", "nets": {"hidden": [256, 256]}}, "robot": None, "empty": {}, "on": True}
    assert settings_table(spec, "spec").rows == [
        ("agent.name", "sac"),
        ("agent.nets.hidden", "[256, 256]"),
        ("robot", "null"),
        ("empty", "{}"),
        ("on", "true"),
    ]


def test_negative_numbers_stay_numbers_in_a_spreadsheet_and_formulas_do_not():
    text = csv_text([{"a": [-1.5, 2.0], "b": [-3e-05], "c": "-x", "d": ["-1", "=2"], "e": -4.0}])
    assert text == "a,b,c,d,e\n-1.5; 2.0,-3e-05,'-x,'-1; =2,-4.0\n"


def test_the_command_of_a_run_can_be_pasted():
    about = {"command": ["karolos", "run", "my spec.yaml", "seeds=[0]"]}
    assert run_facts(RUN, about)["command"] == "karolos run 'my spec.yaml' 'seeds=[0]'"
