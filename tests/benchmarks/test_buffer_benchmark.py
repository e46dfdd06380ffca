from __future__ import annotations

import json

import pytest
from karolos_cli.bench import app
from typer.testing import CliRunner


def test_time_and_memory_of_both_replay_buffers_are_measured() -> None:
    result = CliRunner().invoke(app, ["buffers", "--transitions", "8000", "--seconds", "0.1", "--json"])
    assert result.exit_code == 0, result.output
    rows = {row["case"]: row for row in map(json.loads, result.stdout.splitlines())}
    laid_out = rows["rows of 8,000 transitions as laid out"]
    assert laid_out["value"] == pytest.approx(8000 * 67 * 4 / 1e9, rel=0.2), "pick-and-place takes some 67 numbers"
    for case in (
        "uniform, batch of 256 with hindsight",
        "uniform, adding 1,000 transitions of 16 environments",
        "priority, batch of 256 with hindsight, priorities updated",
        "priority, adding 1,000 transitions of 16 environments",
    ):
        assert rows[case]["unit"] == "ms"
        assert rows[case]["value"] > 0
