"""`karolos run` and what ends it, through the installed command."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from karolos_cli.main import app
from support.commands import call
from support.processes import wait_for

KAROLOS = (sys.executable, "-c", "from karolos_cli import main; main()")
SPEC = """\
environment: toy
agent: {name: sac, hidden: [16], precision: float32}
buffer: {capacity: 1000, hindsight: {strategy: future}}
orchestrator: {processes: 0, environments: 4}
training: {steps: 200, batch_size: 16, replay_ratio: 4, warmup_episodes: 4}
testing: {interval: 100, episodes: 4}
"""
FIXED = ["run", "experiment", "seed", "state", "steps", "seconds"]
FIXED += ["success_any", "success_end", "steps_to_95", "seconds_to_95"]


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "toy.yaml").write_text(SPEC)
    return tmp_path


def test_json_rows_hold_the_fixed_fields_first_and_progress_goes_to_stderr(home):
    code, out, err = call(app, "run", "toy.yaml", "seeds=[0,1]", "--json")
    assert code == 0, err
    rows = [json.loads(line) for line in out.splitlines()]
    assert [row["seed"] for row in rows] == [0, 1]
    for row in rows:
        assert list(row)[:10] == FIXED
        assert (row["state"], row["steps"], row["name"]) == ("finished", 200, "toy")
        assert (home / "runs" / row["run"] / "spec.yaml").read_text() == SPEC
        assert f"{row['run']} at 100 steps" in err


def test_quiet_says_nothing_where_all_is_well(home, capfd):
    assert call(app, "run", "toy.yaml", "--quiet") == (0, "", "")
    assert capfd.readouterr() == ("", "")


def test_a_table_and_the_place_of_the_results_end_a_run(home):
    code, out, err = call(app, "run", "toy.yaml", "--runs", "elsewhere")
    assert code == 0
    assert "success end" in out
    assert "results in elsewhere" in err
    (run,) = (path.parent.name for path in home.glob("elsewhere/*/state.json"))
    assert f"`karolos runs show {run}` shows more, `karolos play {run}` shows it" in err
    assert "finished" in call(app, "runs", "list", "--runs", "elsewhere")[1]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["toy.yaml", "agent.learning_rat=1"], 2, ["agent.learning_rat", "learning_rate"]),
        (["nowhere.yaml"], 2, ["nowhere.yaml"]),
        (["toy.yaml", "buffer.capacity=10"], 2, ["override buffer.capacity=10", "80"]),
        (["toy.yaml", "randomization.task.gravity={name: normal, mean: -9, std: 1}"], 2, ["randomization"]),
        (["toy.yaml", "environment.dimensions=2", "robot=panda"], 2, ["robot"]),
        (["toy.yaml", "--database", "sqlite:///toy.yaml"], 4, ["toy.yaml"]),
        (["toy.yaml", "--detach", "--time-limit", "2hours"], 2, ["--time-limit", "2hours"]),
    ],
)
def test_bad_input_is_a_karolos_error(home, arguments, code, words):
    found, _, err = call(app, "run", *arguments)
    assert found == code, err
    assert all(word in err for word in words), err


def test_a_runs_folder_that_cannot_be_made_is_told(home):
    (home / "taken").write_text("a file")
    found, _, err = call(app, "run", "toy.yaml", "--runs", "taken")
    assert found == 3
    assert "taken" in err


@pytest.mark.usefixtures("real_processes")
def test_ctrl_c_leaves_a_stopped_run_with_a_checkpoint_and_130(home):
    command = [*KAROLOS, "run", "toy.yaml", "training.steps=10000000", "testing.interval=400", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        wait_for(lambda: list(home.glob("runs/*/tests.jsonl")))
        os.kill(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    row = json.loads(out)
    assert row["state"] == "stopped"
    assert row["steps"] >= 400
    assert (Path(row["folder"]) / "checkpoints" / "last" / "manifest.json").is_file()


def test_a_detached_command_goes_on_and_no_second_copy_is_started_meanwhile(home, monkeypatch):
    for wrong in ("unknown=1", "buffer.capacity=10"):
        code, _, err = call(app, "run", "toy.yaml", wrong, "--detach")
        assert (code, wrong in err) == (2, True)
    command = ("run", "toy.yaml", "training.steps=1000000")
    monkeypatch.setattr(sys, "argv", ["karolos", *command, "--detach"])
    code, _, err = call(app, *command, "--detach")
    assert code == 0
    assert "goes on, with its output in runs/toy.log" in err
    process = int(err.split()[1])
    wait_for(lambda: list(home.glob("runs/*/tests.jsonl")))
    try:
        code, _, err = call(app, *command, "--resume")
        assert (code, "another process runs seed 0" in err) == (1, True)
    finally:
        os.kill(process, signal.SIGTERM)
    log = home / "runs" / "toy.log"
    wait_for(lambda: "s0 stopped" in re.sub(r"-\d{8}-\d{6}", "", log.read_text()))
