"""A run that ended too soon goes on as if it had not."""

import json
import re
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.listeners import Heard, stopping_at
from support.run_samples import stored
from support.states import assert_same_runs
from support.toy_runs import fill_disk, run_of

from karolos.errors import MachineError, RunError, UsageError
from karolos.experiment.events import RunStarted
from karolos.experiment.resume import Snapshot, newest_snapshot
from karolos.experiment.run import run_or_resume
from karolos.experiment.signals import StopRequest
from karolos.launchers.experiment import Experiment, resume_run
from karolos.records import RunFolder, checkpoint, provenance
from karolos.specification import Spec, spec_from_dict
from karolos.store import Store

pytestmark = pytest.mark.xdist_group(__name__)

HINDSIGHT = {"strategy": "future"}
BASE: dict[str, Any] = {
    "name": "toy",
    "environment": "toy",
    "orchestrator": {"processes": 0, "environments": 4},
    "training": {"steps": 240, "batch_size": 16, "replay_ratio": 4, "warmup_episodes": 4},
    "testing": {"interval": 100, "episodes": 4},
}
SAC = {"name": "sac", "hidden": [16], "precision": "float32"}
CASES = {
    "sac, priority, hindsight": {
        "agent": SAC,
        "buffer": {"name": "priority", "capacity": 400, "hindsight": HINDSIGHT, "n_step": 2},
    },
    "ppo": {
        "agent": {"name": "ppo", "hidden": [16], "minibatches": 2, "epochs": 2},
        "buffer": {"name": "on_policy", "rollout": 8},
        "training": {"steps": 240},
    },
    "td3, uniform": {"agent": SAC | {"name": "td3"}, "buffer": {"name": "uniform", "capacity": 400}},
}


USUAL = BASE | CASES["sac, priority, hindsight"]


def only(outcome: Any) -> RunFolder:
    (run,) = outcome.runs
    return RunFolder.open(run.folder)


def bit_exact(folder: RunFolder) -> list[bool]:
    """What the run says of each of its resumptions."""
    return [event["bit_exact"] for event in folder.events() if event["event"] == "resumed"]


def test_a_run_whose_files_were_edited_is_not_resumed(tmp_path, monkeypatch):
    folder = RunFolder.create(tmp_path, "toy", 0)
    spec = spec_from_dict(USUAL)
    monkeypatch.setattr(Spec, "files", lambda _: {"task.part": "2"})
    folder.describe(spec.dump(), experiment=spec.hash(), files={"task.part": "1"})
    with pytest.raises(RunError, match=r"the file of task\.part, or one that it names, was changed or is missing; put"):
        run_or_resume(folder, None, lambda _: None, StopRequest(), two_processes=False)


def test_a_run_that_resumes_with_other_software_says_so(broken, monkeypatch):
    there = provenance.versions()
    monkeypatch.setattr(provenance, "versions", lambda: there | {"torch": "1.0", "a-new-plugin": "1"})
    (warned,) = go_on(broken)
    assert f"it began with other software: torch is 1.0 here and {there['torch']} there (it may differ" in warned
    assert bit_exact(broken) == [False]


@pytest.mark.parametrize("case", CASES)
def test_run_in_two_processes_that_is_stopped_and_resumed_equals_one_without_a_break_in_one_bit_for_bit(case, tmp_path):
    spec = BASE | CASES[case]
    whole = run_of(spec, tmp_path / "whole")
    spec |= {"orchestrator": {"processes": 2, "environments": 2}}
    broken = Experiment(spec).run(tmp_path / "broken", listener=stopping_at(100), check=False)
    assert broken.runs[0].state == "stopped"
    assert broken.exit_code == 143
    again = Experiment(spec).run(tmp_path / "broken", existing="resume")
    assert [run.run for run in again.runs] == [run.run for run in broken.runs]
    assert again.runs[0].attempt == 2
    assert_same_runs(whole, only(again))
    assert bit_exact(only(again)) == [True]
    with Store(Store.default_url(tmp_path / "broken")) as store:
        assert [test.steps for test in stored(store, again.runs[0].run).tests] == [100, 200, 240]


def test_a_run_of_a_robot_is_the_same_in_one_process_and_broken_off_in_two(tmp_path, monkeypatch):
    monkeypatch.setattr("karolos.launchers.experiment.cores", lambda: 1)  # test_pending_tests has a process for tests
    spec = BASE | {
        "environment": "robot_task",
        "robot": "panda",
        "task": {"name": "pick_place", "start_grasped": 0.5, "max_steps": 12},
        "training": BASE["training"] | {"steps": 140, "replay_ratio": 1},
        "testing": {"interval": 100, "episodes": 2, "final_episodes": 0},
        "randomization": {"task.object_mass": {"name": "uniform", "low": 0.05, "high": 0.3}},
        "agent": SAC,
        "orchestrator": {"processes": 0, "environments": 2},
    }
    whole = run_of(spec, tmp_path / "whole")
    spec["orchestrator"] = {"processes": 2, "environments": 1}
    run_of(spec, tmp_path / "broken", listener=stopping_at(100))
    assert_same_runs(whole, run_of(spec, tmp_path / "broken", existing="resume"))


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A runs folder with one run that was stopped at 200 of 240 steps."""
    runs = tmp_path_factory.mktemp("stopped")
    run_of(USUAL, runs, listener=stopping_at(200))
    return runs


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """The same run without a break."""
    return run_of(USUAL, tmp_path_factory.mktemp("whole"))


@pytest.fixture
def broken(stopped: Path, tmp_path: Path) -> RunFolder:
    shutil.copytree(stopped, tmp_path / "runs")
    (path,) = (tmp_path / "runs").glob("toy-*")
    return RunFolder.open(path)


def go_on(folder: RunFolder) -> list[str]:
    """Resume the run to its end; returns its warnings."""
    heard = Heard()
    assert resume_run(folder, Store.default_url(folder.path.parent), listener=heard).exit_code == 0
    return heard.warnings


def damage_last(folder: RunFolder) -> None:
    path = folder.checkpoints / "last" / "agent.pt"
    data = bytearray(path.read_bytes())
    data[1000] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("lose", "steps", "warned"),
    [
        (damage_last, 100, r"agent\.pt.*previous checkpoint"),
        (lambda folder: (folder.path / "events.jsonl").write_bytes(b""), 200, None),
        (lambda folder: shutil.rmtree(folder.checkpoints), 0, "the run has no checkpoint .it begins again"),
    ],
    ids=["damaged checkpoint", "no events", "no checkpoint"],
)
def test_a_run_that_lost_files_goes_on_from_the_newest_sound_checkpoint_or_begins_again(
    whole, broken, lose, steps, warned
):
    lose(broken)
    warnings = go_on(broken)
    assert re.search(warned, "\n".join(warnings)) if warned else not warnings
    assert [event["steps"] for event in broken.events() if event["event"] == "resumed"] == [steps]
    assert_same_runs(whole, broken)


def test_a_damaged_checkpoint_does_not_replace_the_one_before(whole, broken, monkeypatch):
    damage_last(broken)
    with monkeypatch.context() as patch:
        fill_disk(patch, lambda name: name != "last")
        with pytest.raises(RunError, match="the policy at the end of training could not be written"):
            resume_run(broken, Store.default_url(broken.path.parent)).check()
    go_on(RunFolder.open(broken.path))
    assert_same_runs(whole, broken)


def test_a_run_that_learns_in_another_precision_is_not_bit_exact(broken):
    events = (broken.path / "events.jsonl").read_text()
    (broken.path / "events.jsonl").write_text(events.replace("float32", "bfloat16"))
    assert "it learns on another machine: precision float32 after bfloat16" in "\n".join(go_on(broken))
    assert bit_exact(broken) == [False]


def test_a_run_that_cannot_be_read_is_not_trained_again(broken):
    (broken.path / "run.json").write_text("{")
    with pytest.raises(RunError, match=r"run\.json is damaged"):
        Experiment(USUAL).run(broken.path.parent, existing="resume")


def test_a_renamed_folder_is_still_the_same_run(whole, broken):
    best = broken.path.rename(broken.path.parent / "best_arm")
    outcome = Experiment(USUAL).run(best.parent, existing="resume")
    assert [run.run for run in outcome.runs] == [broken.id]
    assert_same_runs(whole, RunFolder.open(best))
    tuned = USUAL | {"name": "tuned", "agent": SAC | {"start_from": broken.id}}
    assert Experiment(tuned).run(best.parent).runs[0].state == "finished"


def test_a_missing_index_is_rebuilt_before_a_run(broken):
    go_on(broken)
    runs = broken.path.parent
    (runs / "karolos.sqlite").unlink()
    (runs / "damaged").mkdir()
    (runs / "damaged" / "run.json").write_text("{")
    with pytest.warns(UserWarning, match="damaged"):
        Experiment(USUAL | {"name": "other"}).run(runs)
    with Store(Store.default_url(runs)) as store:
        assert [run.name for run in store.runs()] == ["other", "toy"]
        store.remove_runs([broken.id])
    Experiment(USUAL).run(runs, existing="skip")  # it may have ended elsewhere
    with Store(Store.default_url(runs)) as store:
        assert [run.name for run in store.runs()] == ["other", "toy"]


def test_tests_of_a_run_that_ended_unseen_are_read_from_its_folder(broken):
    runs = broken.path.parent
    index = (runs / "karolos.sqlite").read_bytes()
    go_on(broken)
    (runs / "karolos.sqlite").write_bytes(index)
    with closing(sqlite3.connect(runs / "karolos.sqlite")) as connection, connection:
        connection.execute("update runs set state = 'running'")
    with Store(Store.default_url(runs)) as store:
        assert [test.steps for test in stored(store, broken.id).tests] == [100, 200, 240]


def test_no_sound_checkpoint_is_an_error_of_that_seed_alone_and_nothing_is_lost(broken):
    for name in ("last", "previous"):
        (broken.checkpoints / name / "manifest.json").write_text("{}")
    before = sorted(path for path in broken.path.rglob("*") if path.is_file())
    with pytest.raises(RunError, match="no checkpoint can be used"):
        resume_run(broken, Store.default_url(broken.path.parent))
    both = Experiment(USUAL | {"seeds": [0, 1]}).run(broken.path.parent, existing="resume", check=False)
    assert [(run.seed, run.state) for run in both.runs] == [(0, "failed"), (1, "finished")]
    assert "no checkpoint can be used" in str(both.runs[0].error)
    assert both.exit_code == 1
    assert sorted(path for path in broken.path.rglob("*") if path.is_file()) == before


def test_checkpoint_of_another_experiment_is_refused(broken, tmp_path):
    other = run_of(USUAL | {"agent": SAC | {"tau": 0.01}}, tmp_path)
    shutil.rmtree(broken.checkpoints)
    shutil.copytree(other.checkpoints, broken.checkpoints)
    with pytest.raises(RunError, match="another experiment"):
        resume_run(broken, Store.default_url(broken.path.parent))


def test_settings_that_were_changed_after_the_start_are_refused(broken):
    file = broken.path / "resolved.json"
    file.write_text(file.read_text().replace('"discount": 0.9', '"discount": 0.5'))
    for resume in (
        lambda: resume_run(broken, Store.default_url(broken.path.parent)),
        lambda: Experiment(USUAL).run(broken.path.parent, existing="resume"),
    ):
        with pytest.raises(RunError, match=r"resolved\.json is missing, damaged or changed"):
            resume()
    assert broken.state().state == "stopped"
    assert "resolved.json: missing, damaged or changed" in broken.record().problems


def test_finished_seeds_are_not_run_again(broken):
    go_on(broken)
    spec = USUAL | {"seeds": [0, 1]}
    for existing in ("skip", "resume"):
        heard = Heard()
        outcome = Experiment(spec).run(broken.path.parent, existing=existing, listener=heard)
        assert (outcome.exit_code, outcome.runs[0].run) == (0, broken.id)
        assert [event.seed for event in heard if isinstance(event, RunStarted)] == ([1] if existing == "skip" else [])


def test_a_run_that_ended_while_it_was_looked_at_is_not_executed_again(broken):
    go_on(broken)
    before = broken.events()
    with broken:
        broken.lock()
        url, stop = Store.default_url(broken.path.parent), StopRequest()
        assert run_or_resume(broken, url, pytest.fail, stop, two_processes=False).state == "finished"
    assert broken.events() == before


def test_the_checkpoint_that_a_run_resumed_from_is_not_kept_in_memory(broken, monkeypatch):
    snapshots = []

    def newest(folder: RunFolder) -> Snapshot:
        snapshots.append(newest_snapshot(folder))
        assert snapshots[-1].parts["buffer"]
        return snapshots[-1]

    monkeypatch.setattr("karolos.experiment.run.newest_snapshot", newest)
    go_on(broken)
    assert [snapshot.parts for snapshot in snapshots] == [{}]


def test_episodes_that_go_another_way_when_played_again_are_a_warning(tmp_path):
    spec = BASE | {
        "environment": {"name": "gymnasium", "id": "support.goal_environments:Straying-v0", "flatten_goals": True},
        "agent": SAC,
        "testing": {"interval": 100, "episodes": 4, "final_episodes": 0},
    }
    warnings = go_on(run_of(spec, tmp_path, listener=stopping_at(100)))
    assert "gave another observation: 0, 1, 2, 3 (the run resumes, but not bit for bit" in "\n".join(warnings)


def test_tests_that_an_asynchronous_run_makes_at_other_steps_are_removed(tmp_path):
    spec = USUAL | {"training": BASE["training"] | {"mode": "async"}}
    stopped = run_of(spec, tmp_path, listener=stopping_at(100))
    steps = checkpoint.read_meta(stopped.checkpoints, "last")["steps"]
    kept = [test.steps for test in stopped.tests()]
    stopped.add_test(replace(stopped.tests()[-1], steps=steps + 1))
    done = run_of(spec, tmp_path, existing="resume")
    left = [test.steps for test in done.tests()]
    assert left[: len(kept)] == kept
    assert steps + 1 not in left
    assert bit_exact(done) == [False]
    rows = [json.loads(line) for line in (done.path / "episodes.jsonl").read_text().splitlines()]
    episodes = [(row["environment"], row["index"]) for row in rows]
    assert len(set(episodes)) == len(episodes) >= 240 // 20
    with Store(Store.default_url(tmp_path)) as store:
        assert [test.steps for test in stored(store, done.id).tests] == left


def test_time_limit_stops_with_a_checkpoint(tmp_path):
    spec = USUAL | {"training": BASE["training"] | {"steps": 10**6}}
    outcome = Experiment(spec).run(tmp_path, time_limit=1.5)
    assert outcome.exit_code == 124
    folder = only(outcome)
    assert outcome.runs[0].state == "stopped"
    assert checkpoint.read_meta(folder.checkpoints, "last")["steps"] == outcome.runs[0].steps
    assert folder.events()[-1]["reason"] == "time limit"


@pytest.mark.parametrize("case", ["sac, priority, hindsight", "ppo"])
def test_a_finished_run_goes_on_as_a_run_of_its_own_bit_for_bit(case, tmp_path, monkeypatch):
    spec = BASE | CASES[case]
    longer = spec | {"training": spec["training"] | {"steps": 400}}
    whole, short = run_of(longer, tmp_path / "whole"), run_of(spec, tmp_path)
    before = {path: path.read_bytes() for path in short.path.rglob("*") if path.is_file()}
    url = Store.default_url(tmp_path)
    (short.checkpoints / "previous" / "manifest.json").unlink()  # a sound `last` is enough
    before.pop(short.checkpoints / "previous" / "manifest.json")
    more = only(resume_run(short, url, ["training.steps=400"]))
    assert before == {path: path.read_bytes() for path in short.path.rglob("*") if path.is_file()}
    for part in ("agent", "buffer"):
        assert checkpoint.digest(more.checkpoints, "last", part) == checkpoint.digest(whole.checkpoints, "last", part)
    about = more.description()
    assert about["continued_from"] == {"run": short.id, "steps": 240}
    assert about["experiment"] not in (short.description()["experiment"], whole.description()["experiment"])
    assert [test.steps for test in more.tests()] == [100, 200, 240, 300, 400]
    assert only(resume_run(short, url, ["training.steps=400"])).id == more.id
    for override, words in (("agent.hidden=[8]", "cannot change when a run"), ("training.steps=240", "has taken")):
        with pytest.raises(UsageError, match=words):
            resume_run(short, url, [override])
    there = list(tmp_path.iterdir())
    monkeypatch.setattr("karolos.launchers.experiment.check_parts", lambda _: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        resume_run(short, url, ["training.steps=500"])
    assert list(tmp_path.iterdir()) == there, "what is refused leaves no run"
    monkeypatch.undo()
    fill_disk(monkeypatch, lambda name: name != "last")
    with pytest.raises(MachineError, match="no space left"):
        resume_run(short, url, ["training.steps=500"])
    assert list(tmp_path.iterdir()) == there, "a run that cannot be copied whole is no run"
