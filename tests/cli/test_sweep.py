"""`karolos sweep`: what it says before and after the trials, which tests/test_sweep_search.py runs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import typer
import yaml
from karolos_cli.display import SweepDisplay
from karolos_cli.sweep import report, sweep
from support.commands import Terminal, call
from support.sweep_samples import LEARNING_RATE, sweep_spec, write_sweep

from karolos.records.sweep_records import SweepFinal, Trial
from karolos.specification import spec_from_dict
from karolos.sweep.events import FinalBegan, SweepOutcome, TrialBegan, TrialEnded

ROOT = Path(__file__).parents[2]

app = typer.Typer()
app.command()(sweep)


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
        (["sweep.space.agent.learning_rat={float: [1, 2]}"], 2, ["'learning_rate'"]),
        (["sweep.objective=sucess_end"], 2, ["'sucess_end'", "success_end"]),
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
    return SweepOutcome(**vars(write_sweep(folder, "line", trials, final, asked=len(trials), **settings)))


def test_rows_and_words_tell_what_was_chosen_and_how_far_to_trust_it(home, capsys):
    trials = (
        Trial(0, "line-t000", "complete", {"agent.learning_rate": 1e-3}, (0.9,), ("a",), None),
        Trial(1, "line-t001", "failed", {"agent.learning_rate": 1e-1}, None, (), "a loss that is nan\x1b[2J"),
    )
    final = SweepFinal(0, (2,), (3, 4), (0.9,), {0: (0.8,)}, (0.75,))
    outcome = outcome_of(home, spec_from_dict(sweep_spec(LEARNING_RATE)).sweep, trials, final)
    display = SweepDisplay(outcome.objectives)
    for place, trial in enumerate(trials):
        display(TrialBegan(trial, place, 2, None))
        display(TrialEnded(trial, place + 1, 2, trials[0]))
    display(FinalBegan((0, 1), (2,), "choose"))
    display(FinalBegan((0,), (3, 4), "report"))
    report(outcome, quiet=False, json=True)
    out, err = capsys.readouterr()
    rows = [json.loads(line) for line in out.splitlines()]
    assert [row["success_end"] for row in rows] == [0.9, None]
    assert (rows[0]["success_end_fresh"], rows[0]["success_end_unused"]) == (0.8, 0.75)
    assert rows[0]["agent.learning_rate"] == 1e-3
    assert "trial 1 failed: a loss that is nan" in err
    assert "trials 0, 1 on seed 2, to choose\ntrial 0 on seeds 3, 4, to report\n" in err
    assert "\x1b" not in err
    assert "gap +0.15" in err
    assert outcome.exit_code == 0


def test_bar_shows_trials_and_the_best_so_far():
    first = Trial(0, "line-t000", "complete", {"agent.learning_rate": 1e-3}, (0.9,), ("a",), None)
    second = Trial(1, "line-t001", "running", {"agent.learning_rate": 1e-2}, None, (), None)
    screen = Terminal()
    with SweepDisplay(("success_end",), screen) as display:
        (task,) = display._bars.tasks
        display(TrialBegan(replace(first, state="running", values=None), 0, 4, None))
        assert (task.completed, task.total, task.fields["done"], task.fields["best"]) == (0, 4, "0/4", "")
        display(TrialEnded(first, 1, 4, first))
        display(TrialBegan(second, 1, 4, first))
        assert (task.completed, task.fields["done"]) == (1, "1/4")
        assert task.fields["best"] == "best success_end 0.9 (trial 0)"
        display(FinalBegan((0, 1), (2, 3), "choose"))
        assert (task.completed, task.total, task.description) == (0, 2, "choosing")
    text = screen.text()
    assert "trial 0 complete: success_end 0.9 with agent.learning_rate=0.001 [1/4]" in text
