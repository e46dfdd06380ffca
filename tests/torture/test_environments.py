"""The short version of environments.py: environments that misbehave, in this process."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.hostile import spec

from karolos.errors import PluginError, UsageError
from karolos.launchers.experiment import Experiment


@pytest.mark.parametrize(
    ("trouble", "said"),
    [
        ("reset:raise", "ZeroDivisionError: the inertia is zero"),
        ("reset:exit", "SystemExit: 0"),
        ("step:exit", "SystemExit: 0"),
        ("step:quirky", "QuirkyError"),
        ("step:deep", "RecursionError"),
        ("step:none", "environment.id"),
        ("step:nan", "which is not in its space"),
    ],
)
def test_trouble_in_an_episode_fails_the_run_in_one_line(
    tmp_path: Path, trouble: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("karolos.launchers.experiment.check_parts", lambda *_: None)  # which would refuse it
    outcome = Experiment(spec(trouble)).run(tmp_path, check=False)
    assert (outcome.runs[0].state, outcome.exit_code) == ("failed", 1)
    assert re.search(said, str(outcome.runs[0].error))


@pytest.mark.parametrize("trouble", ["close:raise", "close:exit", "close:quirky", "close:interrupt"])
def test_an_environment_that_cannot_be_closed_costs_a_line(
    tmp_path: Path, trouble: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert Experiment(spec(trouble)).run(tmp_path).runs[0].state == "finished"
    assert "warning: Gymnasium.close failed" in capfd.readouterr().err


def test_what_cannot_be_built_is_refused_before_there_is_a_run(tmp_path: Path) -> None:
    for trouble, error in (
        ("init:exit", PluginError),
        ("init:raise", UsageError),
        ("init:quirky", UsageError),
        ("discrete", UsageError),
    ):
        with pytest.raises(error):
            Experiment(spec(trouble)).run(tmp_path)
    outcome = Experiment(spec("init:hang")).run(tmp_path, time_limit=0.1)
    assert (outcome.runs, outcome.exit_code) == ((), 124)
    assert not list(tmp_path.glob("hostile-*"))
