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
import typer
import yaml
from karolos_cli.display import SweepDisplay
from karolos_cli.plans import report_sweep, sweep, transfer
from support import hostile
from support.commands import Terminal, call
from support.fake_launcher import FakeLauncher
from support.processes import wait_for
from support.sweep_samples import LEARNING_RATE, sweep_spec, write_sweep
from support.transfer_samples import LINE

from karolos.records.sweep_records import FinalBegan, SweepFinal, Trial, TrialChanged
from karolos.specification import spec_from_dict

SOON = 20.0
"""Seconds on a machine with ten busy processes for each core; alone a command ends within two."""
app, transfers = typer.Typer(), typer.Typer()
app.command()(sweep)
transfers.command()(transfer)


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    (tmp_path / "line.yaml").write_text(yaml.safe_dump(sweep_spec(LEARNING_RATE)))
    return tmp_path


def test_a_dry_run_prints_specs_and_runs_nothing(home):
    code, out, err = call(app, "line.yaml", "--dry-run", "--trials", "3", "--json")
    found = [json.loads(line) for line in out.splitlines()]
    assert (code, len(found)) == (0, 3)
    for row in found:
        assert spec_from_dict(row["spec"]).agent.settings.learning_rate == row["agent.learning_rate"]
    assert "3 trials, 1 seeds of 200 steps each" in err
    assert not (home / "runs").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["sweep.space.agent.learning_rate={float: [0, 1]}"], 2, ["agent.learning_rate", "greater than 0"]),
        (["sweep.objective=measures.foo"], 2, ["'measures.foo'", "sweep.objective"]),
        (["sweep.space={}", "sweep.space.agent.learning_rate=null"], 2, ["sweep.space"]),
        (["sweep=null"], 2, ["no sweep"]),
        (["--time-limit", "soon"], 2, ["not a duration"]),
        (["--time-limit", "99999999999d"], 2, ["more than ten years"]),
        (["training.batch_size=4000"], 2, ["buffer"]),
    ],
)
def test_bad_input_is_told_before_the_first_trial(home, arguments, code, words):
    for dry in ([], ["--dry-run"]) if "--time-limit" not in arguments else ([],):
        found, out, err = call(app, "line.yaml", *arguments, *dry)
        assert (found, out) == (code, "")
        assert all(word in err for word in words), err
    assert not (home / "runs" / "sweeps").exists()


def outcome_of(folder, search, trials, final):
    settings = {"objectives": search.objectives, "directions": ("maximize",), "parameters": tuple(search.space)}
    return write_sweep(folder, "line", trials, final, asked=len(trials), **settings)


def test_rows_and_words_tell_what_was_chosen_and_how_far_to_trust_it(home, capsys):
    trials = (
        Trial(0, "line-t000", "complete", {"agent.learning_rate": 1e-3}, (0.9,), ("a",), None),
        Trial(1, "line-t001", "failed", {"agent.learning_rate": 1e-1}, None, (), "a loss that is nan\x1b[2J"),
    )
    final = SweepFinal(0, (2,), (3, 4), (0.9,), {0: (0.8,)}, (0.75,))
    outcome = outcome_of(home, spec_from_dict(sweep_spec(LEARNING_RATE)).sweep, trials, final)
    display = SweepDisplay(outcome.objectives)
    for place, trial in enumerate(trials):
        display(TrialChanged(replace(trial, state="running"), place, 2, None))
        display(TrialChanged(trial, place + 1, 2, trials[0]))
    display(FinalBegan((0, 1), (2,), "choose"))
    display(FinalBegan((0,), (3, 4), "report"))
    report_sweep(outcome, (), quiet=False, json=True)
    out, err = capsys.readouterr()
    rows = [json.loads(line) for line in out.splitlines()]
    assert [row["success_end"] for row in rows] == [0.9, None]
    assert (rows[0]["success_end_fresh"], rows[0]["success_end_unused"]) == (0.8, 0.75)
    assert rows[0]["agent.learning_rate"] == 1e-3
    assert "trial 1 failed: a loss that is nan" in err
    assert "trials 0, 1 on seed 2, to choose\ntrial 0 on seeds 3, 4, to report\n" in err
    assert "\x1b" not in err
    assert "gap +0.15" in err


def test_bar_shows_trials_and_the_best_so_far():
    first = Trial(0, "line-t000", "complete", {"agent.learning_rate": 1e-3}, (0.9,), ("a",), None)
    second = Trial(1, "line-t001", "running", {"agent.learning_rate": 1e-2}, None, (), None)
    screen = Terminal()
    with SweepDisplay(("success_end",), screen) as display:
        (task,) = display._bars.tasks
        display(TrialChanged(replace(first, state="running", values=None), 0, 4, None))
        assert (task.completed, task.total, task.fields["done"], task.fields["best"]) == (0, 4, "0/4", "")
        display(TrialChanged(first, 1, 4, first))
        display(TrialChanged(second, 1, 4, first))
        assert (task.completed, task.fields["done"]) == (1, "1/4")
        assert task.fields["best"] == "best success_end 0.9 (trial 0)"
        display(FinalBegan((0, 1), (2, 3), "choose"))
        assert (task.completed, task.total, task.description) == (0, 2, "choosing")
    text = screen.text()
    assert "trial 0 complete: success_end 0.9 with agent.learning_rate=0.001 [1/4]" in text


def test_a_stopped_matrix_says_how_to_go_on_and_then_reports(tmp_path, monkeypatch):
    small = ("training.steps=40", "seeds=[0]", "transfer.modes=[zero_shot]", "transfer.fine_tune=null")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("karolos.plans.plan.make_launcher", lambda *_: FakeLauncher())
    Path("line.yaml").write_text(yaml.safe_dump(LINE))
    code, _, err = call(transfers, "line.yaml", *small, "--out", "x.html")
    assert (code, "--out: cannot write figures into 'x.html'; name a folder; a" in err) == (2, True)
    code, out, err = call(transfers, "line.yaml", *small, "--time-limit", "0.001s")
    assert (code, out) == (124, "")
    assert "line is stopped: the same command with --resume continues it" in err
    code, out, err = call(transfers, "line.yaml", *small, "--resume", "--json", "--out", "figures")
    assert code == 0, err
    assert [(row["source"], row["target"]) for row in map(json.loads, out.splitlines())][1] == ("fast", "slow")
    assert "2 sources of 40 steps, 2 tests of 10 episodes" in err
    assert Path("runs/transfers/line/report.html").is_file()
    assert {path.name for path in Path("figures").iterdir()} >= {"transfer_zero_shot.pdf", "transfer_retention.svg"}
    code, out, err = call(transfers, "line.yaml", *small, "--resume", "--quiet")
    assert (code, out, err) == (0, "", "")
    code, out, _ = call(transfers, "line.yaml", *small, "--resume")
    assert code == 0
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
