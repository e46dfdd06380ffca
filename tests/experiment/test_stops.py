"""A run that is asked to stop ends soon wherever it is, with a checkpoint; the resumed run equals an unbroken one."""

import os
import signal
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from support import hostile, toy_runs
from support.listeners import Heard, stopping_at
from support.states import assert_same_runs

from karolos.experiment import writer
from karolos.experiment.events import RunAdvanced, RunBusy, RunStarted
from karolos.experiment.signals import StopRequestedError, stop_on_signals
from karolos.launchers.experiment import Experiment
from karolos.records import RunFolder, checkpoint
from karolos.store import Store

REACH = toy_runs.toy(
    toy_runs.REACH,
    task={"reward": "sparse", "max_steps": 10},
    agent={"precision": "float32"},
    buffer={"hindsight": {}},
    training={"steps": 60, "replay_ratio": 1, "warmup_episodes": 0},
    testing={"interval": 60},
    demonstrations={"episodes": 3, "updates": 2},
)
run = partial(toy_runs.run_of, REACH)


def test_stop_during_demonstrations_leaves_a_checkpoint_and_they_are_collected_again(tmp_path):
    def stop(event: object) -> None:
        if isinstance(event, RunBusy) and event.activity == "collecting demonstrations":
            signal.raise_signal(signal.SIGTERM)

    folder = run(tmp_path / "stopped", listener=stop)
    assert folder.state().state == "stopped"
    assert "demonstrated" not in [event["event"] for event in folder.events()]
    assert checkpoint.read_meta(folder.checkpoints, "last")["steps"] == 0
    before = folder.summary().total_seconds
    heard = Heard()
    resumed = run(tmp_path / "stopped", existing="resume", listener=heard)
    assert not heard.warnings
    assert resumed.summary().total_seconds > before + resumed.summary().seconds > before
    assert_same_runs(run(tmp_path / "whole"), resumed)


def test_a_run_that_ends_at_once_between_tests_that_are_far_apart_goes_on_from_a_checkpoint(tmp_path, monkeypatch):
    monkeypatch.setattr("karolos.experiment.checkpointer.LONGEST_SECONDS", 0.0)
    monkeypatch.setattr(writer, "ADVANCE_SECONDS", 0.0)

    def end(event: object) -> None:
        if isinstance(event, RunAdvanced) and event.steps >= 40:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "ended", listener=end)
    (folder,) = map(RunFolder.open, (tmp_path / "ended").glob("*-s0-*"))
    assert 30 <= checkpoint.read_meta(folder.checkpoints, "last")["steps"] < 40
    assert_same_runs(run(tmp_path / "whole"), run(tmp_path / "ended", existing="resume"))


def test_the_file_stop_ends_one_run_and_the_next_seed_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr("karolos.experiment.signals.LOOK_SECONDS", 0.0)

    def ask(event: object) -> None:
        if isinstance(event, RunStarted) and event.seed == 0:
            Path(event.folder, "stop").write_text("karolos runs stop", "utf-8")

    runs = Experiment({**REACH, "seeds": [0, 1]}).run(tmp_path, listener=ask).runs
    assert [run.state for run in runs] == ["stopped", "finished"]
    assert RunFolder.open(runs[0].folder).events()[-1]["reason"] == "karolos runs stop"
    assert not list(tmp_path.glob("*/stop"))


def test_listener_hears_what_a_run_does_besides_training(tmp_path):
    heard = Heard()
    run(tmp_path, listener=heard)
    busy = [event for event in heard if isinstance(event, RunBusy)]
    first, last = {}, {}
    for event in busy:
        first.setdefault(event.activity, (event.done, event.total))
        last[event.activity] = event.done, event.total
    testing = {"testing": (0, 2), "final test": (0, 2)}
    assert first == {"collecting demonstrations": (0, 3), "checkpoint": (0, 1), **testing}
    assert last == {"collecting demonstrations": (3, 3), "checkpoint": (1, 1), "testing": (2, 2), "final test": (2, 2)}


@pytest.mark.parametrize("ignored", [signal.SIGHUP, signal.SIGINT])
def test_what_nohup_or_a_shells_background_ignores_stays_ignored(ignored):
    before = signal.signal(ignored, signal.SIG_IGN)
    try:
        with stop_on_signals() as stop:
            signal.raise_signal(ignored)
        assert not stop.requested
    finally:
        signal.signal(ignored, before)


def test_folder_and_list_say_how_far_a_run_is_before_its_first_test(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "WRITE_SECONDS", 0.0)
    monkeypatch.setattr(writer, "ADVANCE_SECONDS", 0.0)
    steps: list[tuple[int, int]] = []

    def look(event: object) -> None:
        if isinstance(event, RunAdvanced):
            with Store(Store.default_url(tmp_path)) as store:
                steps.append((event.steps, store.runs()[0].steps))

    run(tmp_path, listener=look)
    listed = dict(steps)
    assert listed[40] == 38  # written after the round before


@pytest.mark.parametrize(
    "phase",
    [
        "launchers.experiment.check_parts",
        "experiment.run.make_orchestrator",
        "experiment.run.collect_demonstrations",
        "evaluation.due_tests.make_orchestrator",
        "experiment.run.newest_snapshot",
        "experiment.run.Checkpointer.restore",
    ],
)
def test_a_stop_breaks_off_what_takes_long_and_loses_nothing(phase, tmp_path, monkeypatch):
    resumes = phase.rpartition(".")[2] in ("newest_snapshot", "restore")
    if resumes:
        run(tmp_path, listener=stopping_at(0))

    def long(*_: object, **__: object) -> None:
        begun.append(time.monotonic())
        threading.Timer(0.1, terminate).start()
        time.sleep(20)

    begun: list[float] = []
    with monkeypatch.context() as patch:
        patch.setattr(f"karolos.{phase}", long)
        outcome = Experiment(REACH).run(tmp_path, existing="resume", check=False)
    assert time.monotonic() - begun[0] < 10
    assert outcome.exit_code == 143
    assert all(run.state == "stopped" for run in outcome.runs)
    resumed = run(tmp_path, existing="resume")
    assert resumed.state().state == "finished"
    assert [test.steps for test in resumed.tests()] == [60]


@pytest.mark.parametrize(("processes", "seeds", "jobs"), [(0, [0], 1), (1, [0], 1), (1, [0, 1], 2)])
def test_a_stop_breaks_off_a_step_that_hangs(processes, seeds, jobs, tmp_path):
    asked: list[float] = []
    going: set[str] = set()

    def ask(event: object) -> None:
        if isinstance(event, RunAdvanced):
            going.add(event.run)
            if len(going) == len(seeds) and not asked:
                asked.append(time.monotonic() + 0.3)
                threading.Timer(0.3, terminate).start()

    spec = hostile.spec("late step:hang", processes)
    spec["orchestrator"]["time_limit"] = 60.0
    outcome = Experiment(spec | {"seeds": seeds}).run(tmp_path, listener=ask, jobs=jobs, check=False)
    assert time.monotonic() - asked[0] < 20.0  # on a busy machine; alone within two
    assert outcome.exit_code == 143
    assert {run.state for run in outcome.runs} == {"stopped"}
    assert {RunFolder.open(run.folder).events()[-1]["reason"] for run in outcome.runs} == {"SIGTERM"}


@pytest.mark.parametrize(
    ("file", "function"),
    [("<frozen importlib._bootstrap>", "load"), ("/llvmlite/binding/executionengine.py", "notify"), ("own", "__del__")],
)
def test_a_stop_waits_for_what_an_error_would_damage_or_not_reach(file, function):
    """An import that broke off cannot be made again in a notebook; errors in calls from native code are dropped."""
    scope: dict[str, Any] = {"terminate": terminate, "done": [], "sleep": time.sleep}
    exec(compile(f"def {function}():\n    terminate()\n    done.append(1)", file, "exec"), scope)
    with pytest.raises(StopRequestedError), stop_on_signals() as stop, stop.at_once():
        exec(f"{function}()\nsleep(20)", scope)
    assert scope["done"]


def terminate() -> None:
    os.kill(os.getpid(), signal.SIGTERM)
