"""Rows and text on their way to the terminal."""

from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st
from karolos_cli.output import print_rows

from karolos.report.tables import clean


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


def test_no_rows_print_nothing(capsys):
    print_rows([], json=False)
    print_rows([], json=True)
    assert capsys.readouterr().out == ""


def test_numbers_that_json_has_not_become_null(capsys):
    print_rows([{"value": float("nan"), "values": (1.0, float("inf"))}], json=True)
    assert json.loads(capsys.readouterr().out) == {"value": None, "values": [1.0, None]}
