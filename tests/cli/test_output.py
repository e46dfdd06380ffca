"""Rows and text on their way to the terminal."""

import json
import sys
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st
from karolos_cli.output import print_rows, print_table
from support.commands import Terminal
from support.compared_runs import run

from karolos.report.tables import clean, runs_table


@given(st.text())
def test_clean_text_is_one_printable_line_of_the_same_length(text):
    assert clean(text).isprintable()
    assert len(clean(text)) == len(text)
    assert all(after in (before, "\N{REPLACEMENT CHARACTER}") for before, after in zip(text, clean(text), strict=True))


def test_rows_are_json_objects_or_columns(capsys):
    found = [{"name": "a", "value": 0.5}, {"name": "long name", "value": None}]
    print_rows(found, json=True)
    assert [json.loads(line) for line in capsys.readouterr().out.splitlines()] == found
    print_rows(found, json=False)
    assert capsys.readouterr().out == "name       value\na          0.5\nlong name\n"
    print_rows([{"value": float("nan"), "values": (1.0, float("inf"))}], json=True)
    assert json.loads(capsys.readouterr().out) == {"value": None, "values": [1.0, None]}  # JSON has no others
    print_rows([], json=False)
    print_rows([], json=True)
    assert capsys.readouterr().out == ""


def test_a_narrow_terminal_shows_ids_and_cells_whole_and_leaves_out_optional_columns(monkeypatch, capsys):
    screen = Terminal()
    monkeypatch.setattr(sys, "stdout", screen)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "dumb")
    tested = {"success_any": 0.5, "success_end": 0.25, "steps_to_95": 1000, "seconds_to_95": 12.0}
    shown = replace(run(0, [50]).summary, run="reach-s0-20260101-000000", **tested)
    print_table(runs_table([shown]))
    [line] = [line for line in screen.getvalue().splitlines() if shown.run in line]
    assert "0.25 [0.18, 0.34]" in line
    assert len(line) <= 80
    assert capsys.readouterr().err.startswith("left out, because the terminal is narrow: time to .95 end")
