import json
import re

from karolos_cli.bench import COLUMNS, app
from typer.testing import CliRunner

from karolos.errors import UsageError


def test_a_quick_run_prints_rows_and_advice_and_draws_the_papers_two_experiments(tmp_path):
    figure = tmp_path / "boxes.svg"
    result = CliRunner().invoke(app, ["orchestrator", "--quick", "--json", "--out", str(figure)])
    assert result.exit_code == 0, result.output
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert all(tuple(row) == COLUMNS for row in rows)
    assert all(row["value"] > 0 for row in rows)
    assert {row["unit"] for row in rows} == {"s", "steps/s", "us/step"}
    assert {row["peer"] for row in rows} >= {"gymnasium AsyncVectorEnv", "gymnasium SyncVectorEnv", "1 thread"}
    for word in ("20 resets", "40 resets", "lockstep", "asynchronous", "waiting environment", "parent's CPU time"):
        assert any(word in row["case"] for row in rows), word
    assert re.search(r"should use orchestrator\.processes=\d", result.stderr)
    assert "holds Python's interpreter lock" in result.stderr
    assert figure.read_text().count("axes_") >= 3


def test_a_figure_of_an_unknown_format_is_refused_before_anything_is_measured(tmp_path):
    result = CliRunner().invoke(app, ["orchestrator", "--out", str(tmp_path / "boxes.doc")])
    assert isinstance(result.exception, UsageError)
    assert ".svg" in str(result.exception)
