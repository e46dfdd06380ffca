"""`karolos run` and what ends it, through the installed command."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.commands import karolos, refused, rows
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
    (tmp_path / "taken").write_text("a file")
    return tmp_path


@pytest.mark.usefixtures("home")
def test_an_address_of_ray_without_its_scheme_is_told():
    told = refused("run", "toy.yaml", "--on", "head:10001")
    assert "--on: 'head:10001' is an address without its ray://; give --on ray://head:10001, or on a machine" in told


def test_json_rows_hold_the_fixed_fields_first_and_progress_goes_to_stderr(home):
    told = karolos("run", "toy.yaml", "seeds=[0,1]", "--json")
    found = [json.loads(line) for line in told.out.splitlines()]
    assert [row["seed"] for row in found] == [0, 1]
    for row in found:
        assert list(row)[:10] == FIXED
        assert (row["state"], row["steps"], row["name"]) == ("finished", 200, "toy")
        assert (home / "runs" / row["run"] / "spec.yaml").read_text() == SPEC
        assert f"{row['run']} at 100 steps" in told.err


def test_quiet_says_nothing_where_all_is_well(home, capfd):
    assert karolos("run", "toy.yaml", "--quiet") == (0, "", "")
    assert capfd.readouterr() == ("", "")


def test_a_table_and_the_place_of_the_results_end_a_run(home):
    told = karolos("run", "toy.yaml", "--runs", "elsewhere")
    [row] = rows("runs", "list", "--runs", "elsewhere")
    assert row["state"] == "finished"
    assert "success end" in told.out
    assert "results in elsewhere" in told.err
    shown = f"{row['run']} --runs elsewhere"  # so that the commands work as they stand
    assert f"`karolos runs show {shown}` shows more, `karolos play {shown}` shows it" in told.err


def test_a_shipped_run_is_suggested_by_a_name_that_works(home):
    assert "`karolos runs show shipped:panda_reach` shows more" in karolos("resume", "panda_reach").err
    told = refused("resume", "panda_reach", "training.steps=4000")
    assert "agent.start_from=panda_reach begins a new run from its policy" in told


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["toy.yaml", "agent.learning_rat=1"], 2, ["agent.learning_rat", "learning_rate"]),
        (["nowhere.yaml"], 2, ["nowhere.yaml"]),
        (["toy.yaml", "buffer.capacity=10"], 2, ["override buffer.capacity=10", "80"]),
        (["toy.yaml", "randomization.task.gravity={name: normal, mean: -9, std: 1}"], 2, ["randomization"]),
        (["toy.yaml", "environment.dimensions=2", "robot=panda"], 2, ["robot"]),
        (["toy.yaml", "--database", "sqlite:///toy.yaml"], 4, ["toy.yaml"]),
        (["toy.yaml", "--runs", "taken"], 3, ["taken"]),
        (["toy.yaml", "--detach", "--time-limit", "2hours"], 2, ["--time-limit", "2hours"]),
        (["toy.yaml", "--detach", "unknown=1"], 2, ["unknown=1"]),
        (["toy.yaml", "--detach", "buffer.capacity=10"], 2, ["buffer.capacity=10"]),
    ],
)
def test_bad_input_is_a_karolos_error(home, arguments, code, words):
    told = refused("run", *arguments, code=code)
    assert all(word in told for word in words), told


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
    command = ("run", "toy.yaml", "training.steps=1000000")
    monkeypatch.setattr(sys, "argv", ["karolos", *command, "--detach"])
    told = karolos(*command, "--detach").err
    assert "goes on, with its output in runs/toy.log" in told
    wait_for(lambda: list(home.glob("runs/*/tests.jsonl")))
    try:
        assert "another process runs seed 0" in refused(*command, "--resume", code=1)
    finally:
        os.kill(int(told.split()[1]), signal.SIGTERM)
    log = home / "runs" / "toy.log"
    wait_for(lambda: "s0 stopped" in re.sub(r"-\d{8}-\d{6}", "", log.read_text()))
