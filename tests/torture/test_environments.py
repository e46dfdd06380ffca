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
        ("late reset:raise", "ZeroDivisionError: the inertia is zero"),
        ("late reset:exit", "SystemExit: 0"),
        ("late step:exit", "SystemExit: 0"),
        ("late step:quirky", "QuirkyError"),
        ("late step:deep", "RecursionError"),
        ("tail step:none", "training.diverging"),
        ("tail step:nan", r"training.diverging: \d+ of \d+ training episodes diverged until \d+ steps"),
    ],
)
def test_trouble_in_an_episode_fails_the_run_in_one_line(tmp_path: Path, trouble: str, said: str) -> None:
    outcome = Experiment(spec(trouble)).run(tmp_path, check=False)
    assert (outcome.runs[0].state, outcome.exit_code) == ("failed", 1)
    assert re.search(said, str(outcome.runs[0].error))


@pytest.mark.parametrize("trouble", ["close:raise", "close:exit", "close:quirky", "close:interrupt"])
def test_an_environment_that_cannot_be_closed_costs_a_line(
    tmp_path: Path, trouble: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert Experiment(spec(trouble)).run(tmp_path).runs[0].state == "finished"
    assert "warning: Gymnasium.close failed" in capfd.readouterr().err


def test_what_cannot_be_built_or_begun_is_refused_before_there_is_a_run(tmp_path: Path) -> None:
    for trouble, error in (
        ("init:exit", PluginError),
        ("init:raise", UsageError),
        ("init:quirky", UsageError),
        ("discrete", UsageError),
        ("reset:raise", PluginError),
        ("step:nan", PluginError),
    ):
        with pytest.raises(error):
            Experiment(spec(trouble)).run(tmp_path)
    assert Experiment(spec("init:hang")).run(tmp_path, time_limit=0.1).exit_code == 124
    assert not list(tmp_path.glob("hostile-*"))
