"""`karolos test` and `karolos export`: what they print, keep and refuse."""

import shutil
from pathlib import Path

import pytest
from support.commands import karolos, refused, rows
from support.toy_runs import run_of, toy

from karolos.records.intervals import wilson
from karolos.report.tables import success

pytestmark = pytest.mark.xdist_group(__name__)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_of(toy(training={"steps": 40}, testing={"episodes": 4}), tmp_path_factory.mktemp("runs")).path.parent


def test_a_row_has_the_overrides_and_both_successes_beside_the_runs_own_and_is_shown_with_the_run(runs):
    override, where = "environment.threshold=0.9", ("--runs", runs)
    command = ("test", "@last", override, "--episodes", 5, "--seed", 3, *where)
    [row] = rows(*command)
    assert (row["overrides"], row["episodes"], row["seed"]) == ([override], 5, 3)
    for way in ("success_any", "success_end"):
        assert row[f"{way}_interval"] == list(wilson(round(row[way] * 5), 5))
    assert row["success_any"] >= row["success_end"]
    assert row["own"]["episodes"] == 5
    told = karolos(*command).out
    for part in (override, success(row["success_any"], 5), "unchanged"):
        assert part in told
    shown = karolos("runs", "show", "@last", *where).out
    assert "tests under changed settings" in shown
    assert override in shown
    assert rows("runs", "show", "@last", *where)[0]["transfers"][-1]["overrides"] == [override]


def test_files_are_written_beside_the_run_or_where_they_are_asked_for(runs, tmp_path):
    [row] = rows("export", "@last", "--no-onnx", "--runs", runs)
    assert row["files"] == ["policy.npz", "policy.json", "golden.npz"]
    assert Path(row["folder"]) == runs / row["run"] / "export"
    assert row["error"] < 1e-5
    karolos("export", "@last", "--no-onnx", "--runs", runs, "--out", tmp_path / "out")
    assert (tmp_path / "out" / "policy.npz").is_file()


@pytest.mark.parametrize("command", ["test", "export"])
def test_without_a_best_checkpoint_the_last_is_used_and_told(command, runs, tmp_path):
    (run,) = runs.glob("toy-*")
    folder = shutil.copytree(run, tmp_path / run.name)
    shutil.rmtree(folder / "checkpoints" / "best")  # as in a run that was stopped before its first test
    told = f"{run.name} was never tested and has no checkpoint best: using last"
    assert karolos(command, folder).err.splitlines()[0] == told
    assert "there is no checkpoint 'best'" in refused(command, folder, "--checkpoint", "best", code=1)
    assert "nobody" in refused(command, "nobody", "--runs", runs)


def test_a_policy_that_ships_is_its_last_and_says_so_if_best_is_asked_for(tmp_path):
    arguments = ("panda_reach", "--no-onnx", "--out", tmp_path)
    for asked, told in (((), False), (("--checkpoint", "last"), False), (("--checkpoint", "best"), True)):
        ended = karolos("export", *arguments, *asked, "--json")
        assert '"checkpoint": "last"' in ended.out
        assert ("shipped without the checkpoint best: using last" in ended.err) == told


@pytest.mark.parametrize(
    ("command", "option", "told"),
    [
        ("export", ["robot.name=ur5"], "'robot.name=ur5' changes nothing in a policy; add --bundle"),
        ("test", ["--expert", "--randomize"], "--expert takes no --randomize"),
        ("test", ["--expert", "--checkpoint", "last"], "--expert takes no --checkpoint"),
    ],
)
def test_what_a_command_cannot_use_is_refused(command, option, told):
    assert told in refused(command, "panda_reach", *option)
