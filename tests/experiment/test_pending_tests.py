"""Tests beside training: the same results as in the run's own process, whatever happens to the second one."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.states import assert_same_runs, assert_same_state

from karolos import checkpoint
from karolos.errors import WorkerError
from karolos.evaluation.evaluation_process import EvaluationProcess
from karolos.experiment import experiment, pending_tests
from karolos.experiment.events import RunTested, RunWarned
from karolos.experiment.experiment import Experiment
from karolos.records import RunFolder

SPEC: dict[str, Any] = {
    "name": "toy",
    "environment": "toy",
    "agent": {"name": "sac", "hidden": [16], "precision": "float32"},
    "buffer": {"name": "uniform", "capacity": 400, "hindsight": {"strategy": "future"}},
    "orchestrator": {"processes": 0, "environments": 4},
    "training": {"steps": 240, "batch_size": 16, "replay_ratio": 4, "warmup_episodes": 4},
    "testing": {"interval": 40, "episodes": 6},
}


def run(runs: Path, **options: Any) -> RunFolder:
    (summary,) = Experiment(SPEC).run(runs, **options).runs
    return RunFolder.open(summary.folder)


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A run whose tests are all played in its own process."""
    return run(tmp_path_factory.mktemp("here"))


@pytest.fixture
def processes(monkeypatch: pytest.MonkeyPatch) -> list[EvaluationProcess]:
    """Runs start a second process at their first test; the processes that they started."""
    started: list[EvaluationProcess] = []

    class Recorded(EvaluationProcess):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            started.append(self)

    monkeypatch.setattr(pending_tests, "PATIENCE", 0.0)
    monkeypatch.setattr(pending_tests, "WORTHWHILE", 0.0)
    monkeypatch.setattr(pending_tests, "EvaluationProcess", Recorded)
    monkeypatch.setattr(experiment, "cores", lambda: 2)
    return started


def wait_until_ready(tests: pending_tests.PendingTests) -> None:
    """Advance until the second process plays a test."""
    deadline = time.monotonic() + 60
    while tests._process is not None and tests._process.test is None and time.monotonic() < deadline:
        time.sleep(0.01)
        tests.advance()


def test_results_and_weights_are_those_of_a_run_without_a_second_process(
    here: RunFolder, processes: list[EvaluationProcess], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add = pending_tests.PendingTests.add
    beside = []

    def add_and_wait(tests: pending_tests.PendingTests) -> None:
        add(tests)
        wait_until_ready(tests)
        beside.append(tests._process is not None and tests._process.test is not None)

    monkeypatch.setattr(pending_tests.PendingTests, "add", add_and_wait)
    folder = run(tmp_path)
    assert len(processes) == 1
    assert any(beside)
    assert_same_runs(here, folder)
    best, meta = checkpoint.load(folder.checkpoints, "best")
    expected, expected_meta = checkpoint.load(here.checkpoints, "best")
    assert_same_state(best, expected)
    assert (meta["steps"], meta["updates"]) == (expected_meta["steps"], expected_meta["updates"])
    assert not any(process._process.is_alive() for process in processes)


def test_lost_process_costs_a_warning_and_its_test_is_played_again(
    here: RunFolder, processes: list[EvaluationProcess], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add = pending_tests.PendingTests.add

    def add_and_kill(tests: pending_tests.PendingTests) -> None:
        add(tests)
        if tests._process is not None:
            os.kill(tests._process._process.pid or 0, signal.SIGKILL)

    monkeypatch.setattr(pending_tests.PendingTests, "add", add_and_kill)
    events: list[object] = []
    folder = run(tmp_path, listener=events.append)
    assert len(processes) == pending_tests.MAX_LOSSES
    warnings = [event.warning for event in events if isinstance(event, RunWarned)]
    assert all("test process ended" in warning and "played again" in warning for warning in warnings)
    assert len(warnings) == pending_tests.MAX_LOSSES
    assert_same_runs(here, folder)


def test_stop_with_pending_tests_keeps_them_for_the_resumed_run(
    here: RunFolder, processes: list[EvaluationProcess], tmp_path: Path
) -> None:
    """The second process is not ready before training is over, so every test is pending."""

    def stop_at_the_end(event: object) -> None:
        if isinstance(event, RunTested) and event.result.steps == 40:
            signal.raise_signal(signal.SIGTERM)

    stopped = run(tmp_path, listener=stop_at_the_end)
    assert stopped.state().state == "stopped"
    pending = checkpoint.load(stopped.checkpoints, "last")[0]["run"]["tests"]
    assert [test["steps"] for test in pending] == [80, 120, 160, 200, 240]
    assert_same_runs(here, run(tmp_path, existing="resume"))


def test_stop_during_a_test_abandons_it_and_the_resumed_run_plays_it_again(
    here: RunFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rounds = []
    play = pending_tests.play_episodes

    def stopping(*arguments: Any, on_round: Any, **options: Any) -> Any:
        def count(completed: int) -> None:
            rounds.append(completed)
            if len(rounds) == 70:  # in the second test
                signal.raise_signal(signal.SIGTERM)
            on_round(completed)

        return play(*arguments, on_round=count, **options)

    monkeypatch.setattr(pending_tests, "play_episodes", stopping)
    stopped = run(tmp_path)
    assert stopped.state().state == "stopped"
    assert len(rounds) == 70
    assert [test.steps for test in stopped.tests()] == [40]
    assert checkpoint.read_meta(stopped.checkpoints, "last")["steps"] == 80
    assert_same_runs(here, run(tmp_path, existing="resume"))


def test_tests_are_played_in_parts_by_both_processes_and_join_in_order(
    tmp_path: Path, processes: list[EvaluationProcess], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Training ends before the second process is ready, so that both share the final test."""
    monkeypatch.setattr(pending_tests, "PART_EPISODES", 4)
    spec = SPEC | {"testing": {"interval": 120, "episodes": 6, "final_episodes": 64}}
    play, played = pending_tests.play_episodes, []

    def slowly(environments: Any, agent: Any, seeds: Any, **options: Any) -> Any:
        if options["steps"] == 240:
            wait_until_ready(tests[0])
            played.append(len(seeds))
        return play(environments, agent, seeds, **options)

    tests: list[pending_tests.PendingTests] = []
    begin = pending_tests.PendingTests.__init__
    monkeypatch.setattr(
        pending_tests.PendingTests, "__init__", lambda self, *a, **o: (tests.append(self), begin(self, *a, **o))[1]
    )
    monkeypatch.setattr(pending_tests, "play_episodes", slowly)
    (summary,) = Experiment(spec).run(tmp_path / "both").runs
    monkeypatch.undo()
    monkeypatch.setattr(experiment, "cores", lambda: 1)
    (alone,) = Experiment(spec).run(tmp_path / "alone").runs
    shared, expected = RunFolder.open(summary.folder), RunFolder.open(alone.folder)
    assert_same_runs(expected, shared)
    assert sum(played) < 6 + 64, "the second process has played parts, too"
    final, whole = shared.final(), expected.final()
    assert final is not None
    assert whole is not None
    assert replace(final.last, seconds=0.0) == replace(whole.last, seconds=0.0)


def test_second_process_starts_before_the_first_test_if_many_steps_are_tested_or_warm_up_is_slow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[int] = []

    class Never(pending_tests.EvaluationProcess):
        def __init__(self, *_: Any) -> None:
            started.append(len(tests))
            raise WorkerError("none in this test")

    tests: list[int] = []
    monkeypatch.setattr(experiment, "cores", lambda: 2)
    monkeypatch.setattr(pending_tests, "EvaluationProcess", Never)
    monkeypatch.setattr(pending_tests.PendingTests, "add", lambda self: tests.append(1))
    few = SPEC | {
        "training": SPEC["training"] | {"warmup_episodes": 20},
        "testing": {"interval": 120, "episodes": 6},
    }
    many = SPEC | {"testing": {"interval": 1, "episodes": 100}}
    Experiment(few).run(tmp_path, check=False)
    assert started == []
    tests.clear()
    Experiment(many).run(tmp_path, check=False)
    assert started == [0]
    monkeypatch.setattr(pending_tests, "WORTHWHILE", 0.01)
    monkeypatch.setattr(pending_tests, "MANY_STEPS", 1e9)
    tests.clear()
    Experiment(few).run(tmp_path, check=False)
    assert started == [0, 0]
