"""`karolos test` and `karolos export`: what they print, keep and refuse."""

import json
import shutil
from pathlib import Path

import pytest
from karolos_cli.policy import export, zero_shot
from karolos_cli.runs import show
from support.commands import call
from support.toy_runs import run_of, toy
from typer import Typer

from karolos.records.intervals import wilson
from karolos.report.tables import success

pytestmark = pytest.mark.xdist_group(__name__)

policy_app, export_app, show_app = Typer(), Typer(), Typer()
policy_app.command("test")(zero_shot)
export_app.command()(export)
show_app.command()(show)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_of(toy(training={"steps": 40}, testing={"episodes": 4}), tmp_path_factory.mktemp("runs")).path.parent


def test_a_row_has_the_overrides_and_both_successes_beside_the_runs_own(runs):
    arguments = ("@last", "environment.threshold=0.9", "--episodes", "5", "--seed", "3", "--runs", str(runs))
    code, out, err = call(policy_app, *arguments, "--json")
    assert code == 0, err
    row = json.loads(out)
    assert (row["overrides"], row["episodes"], row["seed"]) == (["environment.threshold=0.9"], 5, 3)
    for way in ("success_any", "success_end"):
        assert row[f"{way}_interval"] == list(wilson(round(row[way] * 5), 5))
    assert row["success_any"] >= row["success_end"]
    assert row["own"]["episodes"] == 5
    code, out, _ = call(policy_app, *arguments)
    assert code == 0
    assert "environment.threshold=0.9" in out
    assert success(row["success_any"], 5) in out
    assert "unchanged" in out


def test_what_was_tested_is_shown_with_the_run(runs):
    call(policy_app, "@last", "environment.max_steps=7", "--runs", str(runs))
    _, out, _ = call(show_app, "@last", "--runs", str(runs))
    assert "tests under changed settings" in out
    assert "environment.max_steps=7" in out
    row = json.loads(call(show_app, "@last", "--runs", str(runs), "--json")[1])
    assert row["transfers"][-1]["overrides"] == ["environment.max_steps=7"]


def test_files_are_written_beside_the_run_or_where_they_are_asked_for(runs, tmp_path):
    code, out, err = call(export_app, "@last", "--no-onnx", "--runs", str(runs), "--json")
    assert code == 0, err
    row = json.loads(out)
    assert row["files"] == ["policy.npz", "policy.json", "golden.npz"]
    assert Path(row["folder"]) == runs / row["run"] / "export"
    assert row["error"] < 1e-5
    call(export_app, "@last", "--no-onnx", "--runs", str(runs), "--out", str(tmp_path / "out"))
    assert (tmp_path / "out" / "policy.npz").is_file()


@pytest.mark.parametrize("app", [policy_app, export_app])
def test_checkpoints_and_runs_that_are_not_there_are_refused(app, runs):
    code, _, err = call(app, "@last", "--checkpoint", "worst", "--runs", str(runs))
    assert code == 2
    assert "'worst'" in err
    code, _, err = call(app, "nobody", "--runs", str(runs))
    assert code == 2
    assert "nobody" in err


@pytest.mark.parametrize("app", [policy_app, export_app])
def test_without_a_best_checkpoint_the_last_is_used_and_told(app, runs, tmp_path):
    (run,) = runs.glob("toy-*")
    folder = shutil.copytree(run, tmp_path / run.name)
    shutil.rmtree(folder / "checkpoints" / "best")  # as in a run that was stopped before its first test
    code, _, err = call(app, str(folder))
    told = f"{run.name} was never tested and has no checkpoint best: using last"
    assert (code, err.splitlines()[0]) == (0, told)
    code, _, err = call(app, str(folder), "--checkpoint", "best")
    assert (code, "there is no checkpoint 'best'" in err) == (1, True)


def test_a_policy_that_ships_is_its_last_and_says_so_if_best_is_asked_for(tmp_path):
    arguments = ("panda_reach", "--no-onnx", "--out", str(tmp_path))
    for asked, told in (((), False), (("--checkpoint", "last"), False), (("--checkpoint", "best"), True)):
        code, out, err = call(export_app, *arguments, *asked, "--json")
        assert (code, json.loads(out)["checkpoint"]) == (0, "last")
        assert ("shipped without the checkpoint best: using last" in err) == told


def test_changes_are_for_bundles_alone(runs: Path) -> None:
    code, _, err = call(export_app, "@last", "robot.name=ur5", "--runs", str(runs))
    assert (code, "'robot.name=ur5' changes nothing in a policy" in err, "add --bundle" in err) == (2, True, True)


@pytest.mark.parametrize("option", [("--randomize",), ("--checkpoint", "last"), ("--checkpoint", "best")])
def test_what_an_expert_does_not_have_is_refused(option):
    code, _, err = call(policy_app, "panda_reach", "--expert", "--episodes", "1", *option)
    assert (code, f"--expert takes no {option[0]}" in err) == (2, True)
