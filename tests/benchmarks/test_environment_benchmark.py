from __future__ import annotations

import json

from karolos_cli.bench import COLUMNS, app
from typer.testing import CliRunner


def test_rows_name_the_bare_physics_as_peer() -> None:
    result = CliRunner().invoke(app, ["environment", "--seconds", "0.1", "--json"])
    assert result.exit_code == 0, result.output
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert all(tuple(row) == COLUMNS for row in rows)
    assert [row["case"] for row in rows] == [
        "panda reach joint",
        "panda reach joint reset",
        "panda reach joint randomized episode",
        "panda reach cartesian",
        "panda reach cartesian reset",
        "panda reach cartesian randomized episode",
    ]
    for row in rows[::3]:
        assert row["peer"] == "bare physics loop"
        assert row["ratio_min"] <= row["ratio"] <= row["ratio_max"]


def test_table_and_one_control_mode() -> None:
    result = CliRunner().invoke(app, ["environment", "--seconds", "0.1", "--control", "joint"])
    assert result.exit_code == 0, result.output
    assert len(result.stdout.splitlines()) == 4
    assert "cartesian" not in result.stdout
