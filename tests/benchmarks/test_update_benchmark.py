from __future__ import annotations

import json

import pytest
from karolos_cli.bench import app
from typer.testing import CliRunner

from karolos.benchmarks import updates
from karolos.benchmarks.updates import measure
from karolos.errors import MachineError, UsageError


def test_each_precision_of_an_agent_has_a_row_with_sampling_and_one_without() -> None:
    result = CliRunner().invoke(app, ["updates", "--only", "sac", "--seconds", "0.1", "--json"])
    assert result.exit_code == 0, result.output
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert [row["case"] for row in rows] == [
        "sac float32, 1 thread",
        "sac float32, learning alone, 1 thread",
        "sac bfloat16, 1 thread",
        "sac bfloat16, learning alone, 1 thread",
    ]
    assert all(row["unit"] == "updates/s" and row["value"] > 0 for row in rows)


def test_an_unknown_agent_is_refused_with_those_that_are_measured() -> None:
    result = CliRunner().invoke(app, ["updates", "--only", "sca"])
    assert isinstance(result.exception, UsageError)
    assert "sac" in str(result.exception)


def test_threads_are_a_list_of_numbers() -> None:
    result = CliRunner().invoke(app, ["updates", "--threads", "1,zero"])
    assert isinstance(result.exception, UsageError)


def test_more_threads_than_cores_are_refused() -> None:
    with pytest.raises(MachineError, match="10000 threads"):
        list(measure(threads=(10_000,)))


def test_peers_that_are_not_installed_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(updates, "installed_peers", list)
    with pytest.raises(MachineError, match="no peer"):
        list(measure(peers=True))
