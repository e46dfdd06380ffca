"""Environments that misbehave in every method: each run ends in time, in one state and with a reason."""

import itertools
import json
import os
import random
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from support.hostile import KINDS, METHODS, spec
from support.torture import SEED, TIMES

from karolos.errors import PluginError, UsageError
from karolos.launchers.experiment import Experiment
from karolos.records import RunFolder

LEAK_BYTES = 2 << 30
"""Address space of an environment that leaks memory, beyond which it fails."""
SECONDS = 120.0
"""In which a command has to end."""


def call(home: Path, *arguments: str, limited: bool) -> tuple[int, str]:
    """Exit code and output of a command; 1000 if it does not end."""
    command = [sys.executable, "-m", "karolos_cli", *arguments]
    if limited:
        command = ["sh", "-c", f'ulimit -v {(LEAK_BYTES + (8 << 30)) >> 10}; exec "$@"', "run", *command]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    how: dict[str, Any] = {"cwd": home, "env": environment, "capture_output": True, "text": True}
    try:
        done = subprocess.run(command, check=False, timeout=SECONDS, **how)
    except subprocess.TimeoutExpired:
        return 1000, ""
    return done.returncode, done.stdout + done.stderr


CASES = list(itertools.product(METHODS, KINDS, (0, 1)))
random.Random(SEED).shuffle(CASES)


@pytest.mark.parametrize(("method", "kind", "processes"), CASES[: TIMES - 1])
def test_commands_end_in_time_and_say_why(tmp_path, method, kind, processes):
    """Of a long test. Exit code 0 goes with a finished run only."""
    (tmp_path / "spec.yaml").write_text(json.dumps(spec(f"{method}:{kind}", processes)))
    checked, said = call(tmp_path, "check", "spec.yaml", limited=kind == "leak")
    assert checked in (0, 2, 3, 130, 1000, -9), said
    assert said or checked not in (2, 3)
    code, said = call(tmp_path, "run", "spec.yaml", "--time-limit", "3s", "--quiet", limited=kind == "leak")
    assert code != 1000, "it does not end"
    states = [RunFolder.open(path.parent).state().state for path in tmp_path.glob("runs/*/run.json")]
    assert (code == 0) == (states == ["finished"])
    assert said.strip() or not 0 < code < 124


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
def test_trouble_in_an_episode_fails_the_run_in_one_line(tmp_path, trouble, said):
    outcome = Experiment(spec(trouble)).run(tmp_path, check=False)
    assert (outcome.runs[0].state, outcome.exit_code) == ("failed", 1)
    assert re.search(said, str(outcome.runs[0].error))


@pytest.mark.parametrize("trouble", ["close:raise", "close:exit", "close:quirky", "close:interrupt"])
def test_an_environment_that_cannot_be_closed_costs_a_line(tmp_path, trouble, capfd):
    assert Experiment(spec(trouble)).run(tmp_path).runs[0].state == "finished"
    assert "warning: Gymnasium.close failed" in capfd.readouterr().err


def test_what_cannot_be_built_or_begun_is_refused_before_there_is_a_run(tmp_path):
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
