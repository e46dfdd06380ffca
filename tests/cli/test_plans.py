"""`karolos sweep` and `karolos transfer`: what they say; tests/plans runs them."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from karolos_cli.display import SweepDisplay
from karolos_cli.plans import report_sweep
from support import hostile
from support.commands import Terminal, karolos, refused
from support.fake_launcher import FakeLauncher
from support.processes import wait_for
from support.sweep_samples import LEARNING_RATE, sweep_spec, write_sweep
from support.transfer_samples import LINE

from karolos.records.sweep_records import FinalBegan, SweepFinal, Trial, TrialChanged
from karolos.specification import spec_from_dict

SOON = 20.0
"""Seconds on a machine with ten busy processes for each core; alone a command ends within two."""
BEST = Trial(0, "line-t000", "complete", {"agent.learning_rate": 1e-3}, (0.9,), ("a",), None)
FAILED = Trial(1, "line-t001", "failed", {"agent.learning_rate": 1e-1}, None, (), "a loss that is nan\x1b[2J")


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    (tmp_path / "line.yaml").write_text(yaml.safe_dump(sweep_spec(LEARNING_RATE)))
    return tmp_path


def test_a_dry_run_prints_specs_and_runs_nothing(home):
    told = karolos("sweep", "line.yaml", "--dry-run", "--trials", "3", "--json")
    found = [json.loads(line) for line in told.out.splitlines()]
    assert len(found) == 3
    for row in found:
        assert spec_from_dict(row["spec"]).agent.settings.learning_rate == row["agent.learning_rate"]
    assert "3 trials, 1 seed of 200 steps each" in told.err
    assert not (home / "runs").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["sweep.space.agent.learning_rate={float: [0, 1]}"], ["agent.learning_rate", "greater than 0"]),
        (["sweep.objective=measures.foo"], ["'measures.foo'", "sweep.objective"]),
        (["sweep.space={}", "sweep.space.agent.learning_rate=null"], ["sweep.space"]),
        (["sweep=null"], ["no sweep"]),
        (["--time-limit", "soon"], ["not a duration"]),
        (["--time-limit", "99999999999d"], ["more than ten years"]),
        (["training.batch_size=4000"], ["buffer"]),
    ],
)
def test_bad_input_is_told_before_the_first_trial(home, arguments, words):
    for dry in ([], ["--dry-run"]) if "--time-limit" not in arguments else ([],):
        told = refused("sweep", "line.yaml", *arguments, *dry)
        assert all(word in told for word in words), told
    assert not (home / "runs" / "sweeps").exists()


def test_rows_and_words_tell_what_was_chosen_and_how_far_to_trust_it(home, capsys):
    trials = [BEST, FAILED]
    search = spec_from_dict(sweep_spec(LEARNING_RATE)).sweep
    known = {"objectives": search.objectives, "directions": ("maximize",), "parameters": tuple(search.space)}
    outcome = write_sweep(home, "line", trials, SweepFinal(0, (2,), (3, 4), (0.9,), {0: (0.8,)}, (0.75,)), **known)
    display = SweepDisplay(outcome.objectives)
    for place, trial in enumerate(trials):
        display(TrialChanged(replace(trial, state="running"), place, 2, None))
        display(TrialChanged(trial, place + 1, 2, BEST))
    display(FinalBegan((0, 1), (2,), "choose"))
    display(FinalBegan((0,), (3, 4), "report"))
    report_sweep(outcome, (), quiet=False, json=True)
    out, err = capsys.readouterr()
    first, second = (json.loads(line) for line in out.splitlines())
    assert (first["success_end"], first["success_end_fresh"], first["success_end_unused"]) == (0.9, 0.8, 0.75)
    assert (first["agent.learning_rate"], second["success_end"]) == (1e-3, None)
    assert "trial 1 failed: a loss that is nan" in err
    assert "trials 0, 1 on seed 2, to choose\ntrial 0 on seeds 3, 4, to report\n" in err
    assert "\x1b" not in err
    assert "gap +0.15" in err


def test_bar_shows_trials_and_the_best_so_far():
    screen = Terminal()
    with SweepDisplay(("success_end",), screen) as display:
        (task,) = display._bars.tasks
        display(TrialChanged(replace(BEST, state="running", values=None), 0, 4, None))
        assert (task.completed, task.total, task.fields["done"], task.fields["best"]) == (0, 4, "0/4", "")
        display(TrialChanged(BEST, 1, 4, BEST))
        display(TrialChanged(replace(FAILED, state="running"), 1, 4, BEST))
        assert (task.completed, task.fields["done"]) == (1, "1/4")
        assert task.fields["best"] == "best success_end 0.9 (trial 0)"
        display(FinalBegan((0, 1), (2, 3), "choose"))
        assert (task.completed, task.total, task.description) == (0, 2, "choosing")
    assert "trial 0 complete: success_end 0.9 with agent.learning_rate=0.001 [1/4]" in screen.text()


def test_a_stopped_matrix_says_how_to_go_on_and_then_reports(home, monkeypatch):
    small = ("training.steps=40", "seeds=[0]", "transfer.modes=[zero_shot]", "transfer.fine_tune=null")
    command = ("transfer", "line.yaml", *small)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("karolos.plans.plan.make_launcher", lambda *_: FakeLauncher())
    Path("line.yaml").write_text(yaml.safe_dump(LINE))
    assert "--out: cannot write figures into 'x.html'; name a folder; a" in refused(*command, "--out", "x.html")
    told = refused(*command, "--time-limit", "0.001s", code=124)
    assert "line is stopped: the same command with --resume continues it" in told
    told = karolos(*command, "--resume", "--json", "--out", "figures")
    assert [(row["source"], row["target"]) for row in map(json.loads, told.out.splitlines())][1] == ("fast", "slow")
    assert "2 sources of 40 steps, 2 tests of 10 episodes" in told.err
    assert Path("runs/transfers/line/report.html").is_file()
    assert {path.name for path in Path("figures").iterdir()} >= {"transfer_zero_shot.pdf", "transfer_retention.svg"}
    assert karolos(*command, "--resume", "--quiet") == (0, "", "")
    out = karolos(*command, "--resume").out
    for word in ("Zero-shot success", "from", "to slow", "random policy", "Wilson"):
        assert word in out
    assert max(map(len, out[: out.index("Zero-shot success:")].splitlines())) <= 100


@pytest.mark.parametrize(
    ("command", "number", "said"),
    [
        ("check", signal.SIGTERM, "terminated"),
        ("sweep", signal.SIGINT, "hostile is stopped: the same command continues it"),
        ("suite", signal.SIGTERM, "all is stopped: the same command with --resume continues it"),
        ("transfer", signal.SIGTERM, "hostile is stopped: the same command with --resume continues it"),
    ],
)
def test_a_signal_ends_a_command_whose_environment_hangs_with_a_line(command, number, said, tmp_path):
    spec = hostile.spec("init:hang", 1)
    spec["sweep"] = {"space": LEARNING_RATE}
    spec["transfer"] = {"variants": {name: {"environment.max_steps": steps} for name, steps in (("a", 5), ("b", 6))}}
    (tmp_path / "hostile.yaml").write_text(json.dumps(spec))
    (tmp_path / "all.yaml").write_text("specs: [hostile.yaml]")
    words = [sys.executable, "-m", "karolos_cli", command, "all.yaml" if command == "suite" else "hostile.yaml"]
    path = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    with subprocess.Popen(words, cwd=tmp_path, env=path, stdout=-1, stderr=-1, text=True) as process:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        wait_for(children.read_text)
        time.sleep(1.0)  # until a worker hangs
        began = time.monotonic()
        process.send_signal(number)
        process.wait()
        assert time.monotonic() - began < SOON
        out, err = process.communicate()
    assert (process.returncode, out, err) == (128 + number, "", f"{said}\n")
