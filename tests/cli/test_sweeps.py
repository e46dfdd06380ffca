import shutil
from pathlib import Path

import pytest
from support.commands import karolos, refused, rows
from support.run_samples import add_run
from support.sweep_samples import some_trial, write_sweep

import karolos as library
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
    found = [line.split() for line in karolos("sweeps", "list").out.splitlines()]
    assert found[0] == ["sweep", "state", "trials", "objective", "best", "trial", "settings"]
    assert found[1][:6] == ["half-20260101-000000", "stopped", "1/3", "success_end", "0.5", "0"]
    assert found[2][:6] == ["done-20260101-000000", "finished", "3/3", "success_end", "0.8", "2"]
    lock = FileLock(runs / "sweeps" / "half" / "lock")
    assert lock.acquire()
    listed = [(row["name"], row["state"], row["best"]) for row in rows("sweeps", "list")]
    assert listed == [("half", "running", 0), ("done", "finished", 2)]
    lock.release()


def test_show_tells_trials_and_how_far_to_trust_the_best(runs):
    told = karolos("sweeps", "show", "done")
    lines = told.out.splitlines()
    assert "success_end_fresh" in lines[0]
    assert "learning_rate" in lines[0]
    assert lines[3].split()[:5] == ["2", "complete", "0.8", "0.7", "1e+03"]
    for part in ("trial 1 failed: a loss that is nan", "best: trial 2", "gap +0.15"):
        assert part in told.err
    (row,) = rows("sweeps", "show", "done-20260101-000000")
    assert (row["state"], row["final"]["chosen"], len(row["trials"])) == ("finished", 2, 3)
    # nobody works on the trial of a sweep that was interrupted
    assert karolos("sweeps", "show", "half").out.splitlines()[2].split()[:2] == ["1", "open"]


def test_a_name_of_no_sweep_or_of_several_is_told(runs):
    assert "there is no sweep 'dome'; did you mean 'done'" in refused("sweeps", "show", "dome")
    shutil.copytree(runs / "sweeps" / "done", runs / "sweeps" / "copy")
    assert "'done' means several sweeps; one of done-2" in refused("sweeps", "show", "done")


def test_without_sweeps_it_says_how_to_make_one(tmp_path):
    told = f"no sweeps in {tmp_path} yet; `karolos sweep SPEC` makes one\n"
    assert karolos("sweeps", "list", "--runs", tmp_path) == (0, "", told)


def test_a_damaged_sweep_is_named_and_the_others_are_listed(runs):
    (runs / "sweeps" / "half" / "sweep.json").write_text("{}")
    (runs / "sweeps" / "done" / "trials.jsonl").open("a").write('{"number":')
    for command, code in (("db reindex", 1), ("db check", 4), ("sweeps list", 0)):
        told = str(karolos(*command.split(), code=code))
        assert "half: sweep.json is damaged; remove that file: `karolos sweep SPEC` writes it again" in told
        assert "done: trials.jsonl:4: the last line is torn; left out" in told
    assert [row["name"] for row in rows("sweeps", "list")] == ["done"]


def test_runs_of_trials_are_listed_on_request(runs):
    write_sweep(runs, "x", [some_trial(0)])
    plain, trial = add_run(runs, 0), add_run(runs, 0, name="x-t000")
    told = karolos("runs", "list", "--limit", 1)
    assert (plain in told.out, trial in told.out) == (True, False)
    assert told.err == "the runs of sweeps' trials are left out; --trials lists them\n"
    assert karolos("runs", "list", "--trials").err == ""
    for trials, option, expected in ((False, [], {plain}), (True, ["--trials"], {plain, trial})):
        assert {row["run"] for row in rows("runs", "list", *option)} == expected
        assert {run.run for run in library.runs(runs=runs, trials=trials)} == expected
