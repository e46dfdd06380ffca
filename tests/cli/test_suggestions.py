"""A mistyped value is answered with the closest one that exists."""

from __future__ import annotations

from pathlib import Path

import pytest
from karolos_cli.main import app
from support.commands import call
from support.run_commands import add_run
from support.sweep_samples import some_trial, write_sweep

from karolos.store import Store


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("KAROLOS_DATABASE", raising=False)
    monkeypatch.setenv("KAROLOS_RUNS", str(tmp_path))
    monkeypatch.setenv("COLUMNS", "200")
    add_run(tmp_path, 0)
    with Store(Store.default_url(tmp_path)) as store:
        store.sweeps.add([write_sweep(tmp_path, "grid", [some_trial(0)])])
    return tmp_path


@pytest.mark.usefixtures("runs")
@pytest.mark.parametrize(
    ("command", "suggestion"),
    [
        ("runs list --state finisched", "did you mean 'finished'?"),
        ("runs list state=finisched", "did you mean 'finished'?"),
        ("runs list agent.learning_rat=1", "did you mean agent.learning_rate?"),
        ("runs list --columns run,sucess_end", "did you mean 'success_end'?"),
        ("runs show reech", "did you mean 'reach'?"),
        ("sweeps show gird", "did you mean 'grid'?"),
        ("inspect robot pnada", "did you mean 'panda'?"),
        ("plugins show robto panda", "did you mean 'robots'?"),
    ],
)
def test_closest_value_is_suggested(command: str, suggestion: str) -> None:
    code, out, err = call(app, *command.split())
    assert code == 2
    assert suggestion in err, err
    assert out == ""
