"""An experiment from Python: what it leaves behind, and what happens when something goes wrong."""

import json
import signal
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from support.fork_server import FORKS
from support.listeners import Heard, stopping_at
from support.states import assert_same_state
from support.toy_runs import fill_disk, run_of, toy

from karolos.errors import MachineError, RunError, StoreError, UsageError
from karolos.experiment.check import check_parts
from karolos.experiment.events import RunEnded, RunStarted, RunTested
from karolos.launchers.experiment import Experiment
from karolos.records import RunFolder, checkpoint
from karolos.report.tables import runs_table
from karolos.specification import load_spec, spec_from_dict
from karolos.store import Store

pytestmark = pytest.mark.xdist_group(__name__)

TOY = toy(
    agent={"hidden": [16], "precision": "float32"},
    buffer={"hindsight": {"strategy": "future"}},
    orchestrator={"environments": 4},
    training={"steps": 240, "batch_size": 16, "warmup_episodes": 4},
    testing={"interval": 100, "episodes": 6},
)
spec = partial(toy, TOY)


def weights(folder: RunFolder, name: str = "last"):
    parts, meta = checkpoint.load(folder.checkpoints, name)
    return parts["agent"], meta


def folders(outcome):
    return [RunFolder.open(run.folder) for run in outcome.runs]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """One experiment of two seeds, told event by event."""
    heard = Heard()
    path = tmp_path_factory.mktemp("specs") / "toy.yaml"
    path.write_text(f"# mine\n{json.dumps(spec(seeds=[3, 1]))}\n")
    outcome = Experiment(load_spec(path)).run(tmp_path_factory.mktemp("runs"), listener=heard)
    return outcome, heard


def test_every_seed_becomes_a_finished_run_in_the_order_of_the_spec_and_the_listener_hears_it_whole(finished):
    outcome, heard = finished
    assert [(run.seed, run.state) for run in outcome.runs] == [(3, "finished"), (1, "finished")]
    assert outcome.exit_code == 0
    assert len({run.experiment for run in outcome.runs}) == 1
    for run in outcome.runs:
        mine = [event for event in heard if event.run == run.run]
        assert isinstance(mine[0], RunStarted)
        assert isinstance(mine[-1], RunEnded)
        assert mine[-1].error is None
        assert sum(isinstance(event, RunTested) for event in mine) == 3


def test_tests_come_at_each_interval_and_at_the_end_on_the_same_seeds(finished):
    outcome, _ = finished
    for folder in folders(outcome):
        tests = folder.tests()
        assert [test.steps for test in tests] == [100, 200, 240]
        assert all(test.episodes == 6 for test in tests)
        assert [test.seconds for test in tests] == sorted(test.seconds for test in tests)
    one, other = (folder.tests()[0] for folder in folders(outcome))
    assert one.reset == other.reset


def test_the_run_folder_holds_all_that_is_needed_to_tell_what_was_run(finished):
    outcome, _ = finished
    folder = folders(outcome)[0]
    assert folder.record().problems == ()
    assert (folder.path / "spec.yaml").read_text().startswith("# mine\n")
    assert Experiment(folder.spec()).spec.hash() == outcome.runs[0].experiment
    assert folder.description()["versions"].keys() >= {"python", "karolos", "torch", "numpy"}
    assert [event["event"] for event in folder.events()] == ["started", "layout", "final_test", "finished"]
    assert checkpoint.names(folder.checkpoints) == ("best", "last", "previous")
    assert not folder.is_locked()


def test_every_training_episode_is_recorded(finished):
    outcome, _ = finished
    for folder in folders(outcome):
        rows = [json.loads(line) for line in (folder.path / "episodes.jsonl").read_text().splitlines()]
        assert len(rows) == 240 // 20
        assert sum(row["steps"] for row in rows) == 240
        assert {row["environment"] for row in rows} == {0, 1, 2, 3}
        fields = {"environment", "index", "seed", "steps", "total_reward", "any", "end", "reset", "diverged"}
        assert rows[0].keys() == fields


def test_what_randomization_drew_stands_with_the_episode_and_tests_are_spared(tmp_path):
    changes = {
        "environment": "robot_task",
        "robot": "panda",
        "task": {"name": "reach", "max_steps": 5},
        "randomization": {"task.gravity": {"name": "normal", "mean": -9.81, "std": 0.5}},
        "training": {"steps": 40},
        "testing": {"interval": 40, "episodes": 2},
    }
    episodes = (run_of(spec(**changes), tmp_path).path / "episodes.jsonl").read_text()
    drawn = [json.loads(line)["parameters"]["task.gravity"] for line in episodes.splitlines()]
    assert len(set(drawn)) == len(drawn) == 8
    assert np.mean(drawn) == pytest.approx(-9.81, abs=1)


def test_the_best_checkpoint_is_of_the_best_test_and_the_last_of_the_end(finished):
    outcome, _ = finished
    for folder in folders(outcome):
        merits = {(test.success_end, test.success_any): test.steps for test in folder.tests()}
        assert weights(folder, "best")[1]["steps"] == merits[max(merits)]
        assert weights(folder, "last")[1]["steps"] == 240


SIDE_BY_SIDE = """
from karolos.launchers.experiment import Experiment
outcome = Experiment({spec!r}).run({runs!r}, jobs=2, listener=lambda event: print(type(event).__name__))
print("EXIT", outcome.exit_code, [(run.seed, run.state) for run in outcome.runs])
"""


def test_a_script_without_a_guard_runs_seeds_side_by_side_as_one_after_the_other(finished, tmp_path):
    outcome, _ = finished
    script, runs = tmp_path / "script.py", tmp_path / "runs"
    script.write_text(FORKS + SIDE_BY_SIDE.format(spec=spec(seeds=[3, 1]), runs=str(runs)))
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120, check=False)
    *events, end = done.stdout.splitlines()
    assert end == "EXIT 0 [(3, 'finished'), (1, 'finished')]", done.stderr
    assert {"RunStarted", "RunTested", "RunEnded"} <= set(events)
    assert len(list(runs.glob("toy-*"))) == 2, "each process has run its seed alone, and not the script"
    for before in folders(outcome):
        (path,) = runs.glob(f"toy-s{before.description()['seed']}-*")
        assert_same_state(weights(RunFolder.open(path))[0], weights(before)[0])


@pytest.mark.parametrize(
    ("signals", "end", "code"),
    [
        ([signal.SIGINT], KeyboardInterrupt, None),
        ([signal.SIGINT] * 2, KeyboardInterrupt, None),  # the second one does not wait for the end of the round
        ([signal.SIGTERM], SystemExit, "143"),
        ([signal.SIGHUP], SystemExit, "129"),
    ],
)
def test_a_signal_ends_the_round_and_a_script_of_several_experiments_and_leaves_a_checkpoint(
    tmp_path, signals, end, code
):
    before = signal.signal(signals[0], signal.default_int_handler)  # the tests may run under nohup, which ignores it
    try:
        with pytest.raises(end, match=code):
            Experiment(spec(seeds=[0, 1])).run(tmp_path, listener=stopping_at(100, *signals))
        assert signal.getsignal(signals[0]) is signal.default_int_handler
    finally:
        signal.signal(signals[0], before)
    with Store(Store.default_url(tmp_path)) as store:
        (run,) = store.runs()
    assert run.state == "stopped"
    if len(signals) == 1:
        assert run.steps == weights(RunFolder.open(run.folder))[1]["steps"] == 100


def test_a_plugin_that_raises_fails_its_run_with_traceback_and_the_other_seeds_go_on(tmp_path, monkeypatch):
    def learn(self, batch):
        raise ZeroDivisionError("boom")

    monkeypatch.setattr("karolos.agents.sac.SAC.learn", learn)
    heard = Heard()
    outcome = Experiment(spec(seeds=[0, 1])).run(tmp_path, listener=heard, check=False)
    assert [(run.state, run.error) for run in outcome.runs] == [("failed", "ZeroDivisionError: boom")] * 2
    assert outcome.exit_code == 1
    with pytest.raises(RunError, match=r"2 of 2 runs failed: toy-s0.*ZeroDivisionError: boom"):
        outcome.check()  # which a script does by default
    ends = [event for event in heard if isinstance(event, RunEnded)]
    assert all("def learn" not in end.error and "raise ZeroDivisionError" in end.traceback for end in ends)
    assert "raise ZeroDivisionError" in folders(outcome)[0].events()[-1]["traceback"]


def test_a_loss_that_is_not_a_number_stops_the_run_and_names_it(tmp_path, monkeypatch):
    from karolos.agents.sac import SAC

    learn = SAC.learn

    def broken(self, batch):
        return dict(learn(self, batch)) | {"policy_loss": float("nan")}

    monkeypatch.setattr("karolos.agents.sac.SAC.learn", broken)
    with pytest.raises(RunError, match="policy_loss is nan after"):
        Experiment(spec()).run(tmp_path)


@pytest.mark.parametrize(("fails", "state"), [(5, "finished"), (10**6, "failed")])
def test_a_full_disk_costs_warnings_and_a_run_whose_policy_is_never_written_fails(tmp_path, monkeypatch, fails, state):
    left = iter(range(fails))  # two of three tests, and the end of training
    fill_disk(monkeypatch, lambda _: next(left, None) is None)
    heard = Heard()
    outcome = Experiment(spec()).run(tmp_path, listener=heard, check=False)
    assert (outcome.runs[0].state, outcome.exit_code) == (state, int(state == "failed"))
    assert any("no space left" in warning and "'last' was not written" in warning for warning in heard.warnings)
    if state == "finished":
        assert weights(*folders(outcome))[1]["steps"] == 240
    else:
        assert "the policy at the end of training could not be written" in outcome.runs[0].error


def test_a_best_test_whose_checkpoint_was_not_written_keeps_no_later_one_from_being_written(tmp_path, monkeypatch):
    failed = []
    fill_disk(monkeypatch, lambda name: name != "best" or failed or failed.append(name))
    monkeypatch.setattr("karolos.experiment.checkpointer._rank", lambda result: (1 / result.steps,))  # the first: best
    folder = run_of(spec(), tmp_path)
    assert failed
    assert checkpoint.read_meta(folder.checkpoints, "best")["steps"] == folder.tests()[1].steps


def test_a_full_disk_under_the_test_results_fails_the_run(tmp_path, monkeypatch):
    def full(*_):
        raise MachineError("no space left on the disk")

    monkeypatch.setattr("karolos.records.RunFolder.add_test", full)
    with pytest.raises(RunError, match="no space left on the disk"):
        Experiment(spec()).run(tmp_path)


def test_a_run_whose_end_cannot_be_written_says_how_to_continue_it(tmp_path, monkeypatch):
    def full(*_):
        raise MachineError("the disk is full", hint="free some space")

    monkeypatch.setattr("karolos.experiment.writer.RunWriter.end", full)
    with pytest.raises(MachineError, match="free some space; `karolos resume` then continues from the newest"):
        Experiment(spec()).run(tmp_path)


def test_a_newer_database_is_refused_before_anything_runs(tmp_path):
    with Store(Store.default_url(tmp_path)) as store, store.writing() as connection:
        connection.exec_driver_sql("UPDATE karolos_schema SET version = version + 1")
    with pytest.raises(StoreError, match="a newer karolos made this database"):
        Experiment(spec()).run(tmp_path)
    assert [path.name for path in tmp_path.iterdir() if path.is_dir()] == []


def test_jobs_below_one_are_refused(tmp_path):
    with pytest.raises(UsageError, match="jobs is 0"):
        Experiment(spec()).run(tmp_path, jobs=0)


def test_the_papers_first_listing_is_a_valid_experiment():
    experiment = Experiment({"robot": "panda", "task": "reach", "agent": "sac"})
    assert experiment.spec.dump()
    assert experiment.spec.name == "panda_reach"


def test_a_run_without_updates_says_so(tmp_path):
    without = spec(training={"warmup_episodes": 1000})
    assert "a run may make no update: 1000 warm-up episodes" in check_parts(spec_from_dict(without))
    assert check_parts(spec_from_dict(spec())) is None
    [summary] = Experiment(without).run(tmp_path).runs
    assert (summary.state, summary.updates) == ("finished", 0)
    source = RunFolder.open(summary.folder)
    [warning] = [event for event in source.events() if event["event"] == "warning"]
    assert warning["error"] == "the run made no gradient update"
    assert "its policy is that of an untrained agent" in str(warning)
    started = without | {"agent": {**without["agent"], "start_from": source.id, "start_checkpoint": "last"}}
    [again] = Experiment(started | {"name": "started"}).run(tmp_path).runs
    [warning] = [event for event in RunFolder.open(again.folder).events() if event["event"] == "warning"]
    assert f"its policy is what it started from, {source.id}" in str(warning)
    assert "finished, no update" in runs_table([summary]).rows[0]
