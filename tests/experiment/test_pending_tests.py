"""Tests beside training: the same results as in the run's own process, whatever happens to the second one."""

import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.listeners import Heard
from support.states import assert_same_runs, assert_same_state
from support.toy_runs import run_of, toy

from karolos.evaluation import due_tests
from karolos.experiment import pending_tests
from karolos.experiment.pending_tests import PendingTests
from karolos.launchers import experiment
from karolos.records import RunFolder, checkpoint
from karolos.specification import spec_from_dict

pytestmark = pytest.mark.xdist_group(__name__)

SPEC = toy(
    buffer={"capacity": 400, "hindsight": {"strategy": "future"}},
    orchestrator={"environments": 4},
    training={"steps": 240, "batch_size": 16, "warmup_episodes": 4},
    testing={"interval": 40, "episodes": 6},
)


def run(runs: Path, **options: Any) -> RunFolder:
    return run_of(SPEC, runs, **options)


def second_processes() -> list[Any]:
    return [process for process in multiprocessing.active_children() if process.name.startswith("SpawnProcess")]


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A run whose tests are all played in its own process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(experiment, "cores", lambda: 1)
        return run(tmp_path_factory.mktemp("alone"))


@pytest.fixture
def beside(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Runs start a second process in their first test, and play tests in parts. The results that it sends."""
    received: list[object] = []

    class Recorded(pending_tests.EvaluationProcess):
        def submit(self, test: Any) -> Any:
            future = super().submit(test)
            future.add_done_callback(lambda done: done.exception() or received.append(done.result()))
            return future

    monkeypatch.setattr(due_tests, "PART", 4)
    monkeypatch.setattr(pending_tests, "MEASURED_SECONDS", 0.0)
    monkeypatch.setattr(pending_tests, "WORTHWHILE_SECONDS", 0.0)
    monkeypatch.setattr(pending_tests, "EvaluationProcess", Recorded)
    monkeypatch.setattr(experiment, "cores", lambda: 2)
    return received


def wait_for(received: list[object], tests: PendingTests) -> None:
    """Advance until the second process has sent something."""
    until = time.monotonic() + 60
    while not received and time.monotonic() < until:
        tests.advance()
        time.sleep(0.02)


def after_add(monkeypatch: pytest.MonkeyPatch, do: Callable[[PendingTests], object]) -> None:
    """Do something after each test that becomes due."""
    add = PendingTests.add
    monkeypatch.setattr(PendingTests, "add", lambda tests: (add(tests), do(tests))[0])


def test_results_and_weights_are_those_of_a_run_without_a_second_process(alone, beside, tmp_path, monkeypatch):
    after_add(monkeypatch, lambda tests: wait_for(beside, tests))
    folder = run(tmp_path)
    assert beside, "the second process has played a test"
    assert_same_runs(alone, folder)
    (best, meta), (expected, expected_meta) = (checkpoint.load(one.checkpoints, "best") for one in (folder, alone))
    assert_same_state(best, expected)
    assert (meta["steps"], meta["updates"]) == (expected_meta["steps"], expected_meta["updates"])
    assert not second_processes()


def signal_processes(number: int) -> None:
    for process in second_processes():
        os.kill(process.pid, number)


def test_a_lost_process_costs_a_warning_and_its_test_is_played_again(alone, beside, tmp_path, monkeypatch):
    after_add(monkeypatch, lambda _: signal_processes(signal.SIGKILL))
    heard = Heard()
    folder = run(tmp_path, listener=heard)
    assert len(heard.warnings) == pending_tests.MAX_LOST_PROCESSES
    assert all("test process failed" in warning and "played again" in warning for warning in heard.warnings)
    assert_same_runs(alone, folder)


def test_a_process_that_hangs_costs_nothing_and_training_waits_for_the_tests(alone, beside, tmp_path, monkeypatch):
    waiting = []

    def look(tests: PendingTests) -> None:
        signal_processes(signal.SIGSTOP)
        waiting.append([test.steps for test in tests.pending if not tests._is_over(test)])

    after_add(monkeypatch, look)
    assert_same_runs(alone, run(tmp_path))
    assert waiting == [[], [80], [120], [160], [200], [240]]
    assert not beside
    assert not second_processes()


def test_a_process_that_fails_says_why_and_one_that_cannot_start_costs_nothing(alone, beside, tmp_path, monkeypatch):
    class Unable(pending_tests.EvaluationProcess):
        def __init__(self, spec: Any) -> None:
            super().__init__(spec.model_copy(update={"name": "/"}))  # which its process refuses

        def submit(self, test: Any) -> Any:
            if not attempts:
                attempts.append(1)
                raise OSError("no memory")
            return super().submit(test)

    attempts: list[int] = []
    monkeypatch.setattr(pending_tests, "EvaluationProcess", Unable)
    folder = run(tmp_path)
    first, *others = [str(event["error"]) for event in folder.events() if event["event"] == "warning"]
    assert first == "the test process failed: OSError: no memory"
    assert all("the test process failed: SpecError" in error for error in others)
    assert_same_runs(alone, folder)


def test_a_stop_with_pending_tests_keeps_them_for_the_resumed_run(alone, beside, tmp_path, monkeypatch):
    """The second process is not ready before training is over, so every test is pending."""

    def stop_at_the_end(tests: PendingTests) -> None:
        if tests.pending[-1].steps == 240:
            signal.raise_signal(signal.SIGTERM)

    with monkeypatch.context() as patch:
        patch.setattr(PendingTests, "_waiting", lambda _: 0)
        after_add(patch, stop_at_the_end)
        stopped = run(tmp_path)
    assert stopped.state().state == "stopped"
    pending = checkpoint.load(stopped.checkpoints, "last")[0]["run"]["tests"]
    assert [test["steps"] for test in pending] == [40, 80, 120, 160, 200, 240]
    (told,) = [event["error"] for event in stopped.events() if event["event"] == "warning"]
    assert told == "no test was played after 40, 80, 120, 160, 200, 240 steps, where it is due"
    assert_same_runs(alone, run(tmp_path, existing="resume"))


def test_a_stop_during_a_test_abandons_it_and_the_resumed_run_plays_it_again(alone, tmp_path, monkeypatch):
    rounds = []
    play = due_tests.play_episodes

    def stopping(*arguments: Any, on_round: Any, **options: Any) -> Any:
        def count(completed: int) -> None:
            rounds.append(completed)
            if len(rounds) == 70:  # in the second test
                signal.raise_signal(signal.SIGTERM)
            on_round(completed)

        return play(*arguments, on_round=count, **options)

    monkeypatch.setattr(due_tests, "play_episodes", stopping)
    stopped = run(tmp_path)
    assert stopped.state().state == "stopped"
    assert len(rounds) == 70
    assert [test.steps for test in stopped.tests()] == [40]
    assert checkpoint.read_meta(stopped.checkpoints, "last")["steps"] == 80
    assert_same_runs(alone, run(tmp_path, existing="resume"))


def test_the_end_of_the_second_process_ends_no_other():
    process = due_tests.EvaluationProcess(spec_from_dict(SPEC))
    other = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(60,), daemon=True)
    other.start()
    process.close(kill=True)
    assert other.is_alive()
    other.kill()
    other.join()


def test_no_second_process_starts_for_short_tests(tmp_path, monkeypatch):
    monkeypatch.setattr(experiment, "cores", lambda: 2)
    monkeypatch.setattr(pending_tests, "EvaluationProcess", lambda _: pytest.fail("it starts"))
    assert run(tmp_path).state().state == "finished"
    monkeypatch.setattr(pending_tests, "MEASURED_SECONDS", 0.0)
    assert run(tmp_path).state().state == "finished"
