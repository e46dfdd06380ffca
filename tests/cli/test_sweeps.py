import shutil
from pathlib import Path

import pytest
from karolos_cli.db import app as db
from karolos_cli.runs import app as list_of_runs
from karolos_cli.sweeps import app
from support.run_commands import call, rows
from support.run_samples import add_run
from support.sweep_samples import some_trial, write_sweep

import karolos
from karolos.errors import UsageError
from karolos.records.sweep_records import SweepFinal
from karolos.system.files import FileLock


@pytest.fixture
def runs(runs: Path) -> Path:
    """A runs folder with a sweep that came to its end, and one that was interrupted."""
    trials = [some_trial(0, value=0.9), some_trial(1, "failed"), some_trial(2, value=0.8)]
    final = SweepFinal(2, (1,), (2,), (0.8, 1000.0), {0: (0.6, 1500.0), 2: (0.7, 1200.0)}, (0.65, 1300.0))
    write_sweep(runs, "done", trials, final)
    write_sweep(runs, "half", [some_trial(0), some_trial(1, "running")], created="2026-01-02T00:00:00.000000Z")
    return runs


def test_list_says_how_far_sweeps_are_and_which_trial_is_best(runs):
    found = call(app, "list").stdout.splitlines()
    assert found[0].split() == ["sweep", "state", "trials", "objective", "best", "trial", "settings"]
    assert found[1].split()[:6] == ["half-20260101-000000", "stopped", "1/3", "success_end", "0.5", "0"]
    assert found[2].split()[:6] == ["done-20260101-000000", "finished", "3/3", "success_end", "0.8", "2"]
    lock = FileLock(runs / "sweeps" / "half" / "lock")
    assert lock.acquire()
    assert [(row["name"], row["state"], row["best"]) for row in rows(app, "list")] == [
        ("half", "running", 0),
        ("done", "finished", 2),
    ]
    lock.release()


def test_show_tells_trials_and_how_far_to_trust_the_best(runs):
    told = call(app, "show", "done")
    lines = told.stdout.splitlines()
    assert "success_end_fresh" in lines[0]
    assert "learning_rate" in lines[0]
    assert lines[3].split()[:5] == ["2", "complete", "0.8", "0.7", "1e+03"]
    assert "trial 1 failed: a loss that is nan" in told.stderr
    assert "best: trial 2" in told.stderr
    assert "gap +0.15" in told.stderr
    (row,) = rows(app, "show", "done-20260101-000000")
    assert (row["state"], row["final"]["chosen"], len(row["trials"])) == ("finished", 2, 3)


def test_a_trial_that_nobody_works_on_is_open_and_not_running(runs):
    assert call(app, "show", "half").stdout.splitlines()[2].split()[:2] == ["1", "open"]


def test_a_name_of_no_sweep_or_of_several_is_told(runs):
    with pytest.raises(UsageError, match="there is no sweep 'dome'; did you mean 'done'"):
        call(app, "show", "dome")
    shutil.copytree(runs / "sweeps" / "done", runs / "sweeps" / "copy")
    with pytest.raises(UsageError, match="'done' means several sweeps; one of done-2"):
        call(app, "show", "done")


def test_without_sweeps_it_says_how_to_make_one(tmp_path):
    told = call(app, "list", "--runs", tmp_path)
    assert (told.stdout, told.stderr) == ("", f"no sweeps in {tmp_path} yet; `karolos sweep SPEC` makes one\n")


def test_a_damaged_sweep_is_named_and_the_others_are_listed(runs):
    (runs / "sweeps" / "half" / "sweep.json").write_text("{}")
    (runs / "sweeps" / "done" / "trials.jsonl").open("a").write('{"number":')
    damaged = "half: sweep.json is damaged; remove that file: `karolos sweep SPEC` writes it again"
    torn = "done: trials.jsonl:4: the last line is torn; left out"
    for told in (
        call(db, "reindex", exit_code=1).stderr,
        call(db, "check", exit_code=4).stdout,
        call(app, "list").stderr,
    ):
        assert damaged in told
        assert torn in told
    assert [row["name"] for row in rows(app, "list")] == ["done"]


def test_runs_of_trials_are_listed_on_request(runs):
    write_sweep(runs, "x", [some_trial(0)])
    plain, trial = add_run(runs, 0), add_run(runs, 0, name="x-t000")
    told = call(list_of_runs, "list", "--limit", 1)
    assert plain in told.stdout
    assert trial not in told.stdout
    assert told.stderr == "the runs of sweeps' trials are left out; --trials lists them\n"
    assert [row["run"] for row in rows(list_of_runs, "list")] == [plain]
    assert {row["run"] for row in rows(list_of_runs, "list", "--trials")} == {plain, trial}
    assert call(list_of_runs, "list", "--trials").stderr == ""
    assert [run.run for run in karolos.runs(runs=runs)] == [plain]
    assert {run.run for run in karolos.runs(runs=runs, trials=True)} == {plain, trial}
