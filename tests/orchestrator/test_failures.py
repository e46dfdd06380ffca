"""What reaches the user when an environment, a worker or the machine fails, and what is left behind: nothing."""

import multiprocessing
import os
import pickle
import re
import signal
import threading
from contextlib import ExitStack
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest
from support import fake_environments
from support.fake_environments import (
    COMPLAIN,
    CUT,
    DIE,
    END,
    EXIT,
    FINE,
    HANG,
    HUGE,
    INTERRUPT,
    NAN,
    QUIRKY,
    RAISE,
    SEGFAULT,
    SLOW,
    WORTHLESS,
    Fake,
    Fickle,
)
from support.layouts import IN_PROCESS, ONE, THREADS, TWO, every_layout, make, reset, step
from support.processes import kill_worker, wait_until_gone

from karolos.errors import KarolosError, MachineError, PluginError, WorkerError
from karolos.orchestrator import pool, processes
from karolos.orchestrator.executor import as_karolos_error
from karolos.orchestrator.local import Local
from karolos.orchestrator.worker import build_environments


def _refuse(*_: object) -> None:
    raise BlockingIOError(11, "Resource temporarily unavailable")


@every_layout
@pytest.mark.parametrize(
    ("trouble", "kind", "told"),
    [
        (RAISE, WorkerError, r"environment 2: .*fake_environments\.py:\d+: ZeroDivisionError: the inertia is zero$"),
        (COMPLAIN, PluginError, r"^robot\.fake: the gripper has three fingers; give it two$"),
        (EXIT, WorkerError, "SystemExit: enough"),
        (CUT, PluginError, r"Fake returns observation of shape \(1,\), its signature says \(5,\)"),
        (QUIRKY, KarolosError, "quirky; do not"),  # its class cannot be pickled
    ],
)
def test_what_a_step_raises_arrives_in_one_line(layout, trouble, kind, told):
    with make(layout) as orchestrator:
        reset(orchestrator)
        step(orchestrator, FINE, FINE, trouble, FINE)
        with pytest.raises(kind, match=told) as caught:
            orchestrator.receive()
    assert "\n" not in str(caught.value)
    assert trouble != RAISE or "_fail_deep_inside" in caught.value.traceback


@every_layout
def test_a_step_that_is_not_finite_ends_the_episode_as_diverged_with_the_state_before(layout):
    with make(layout) as orchestrator:
        reset(orchestrator)
        step(orchestrator, NAN, HUGE, WORTHLESS, FINE)
        found = orchestrator.receive().step
        assert found.diverged.tolist() == found.truncated.tolist() == [True, True, True, False]
        assert found.observation[:, 1].tolist() == [0, 0, 0, 1]
        assert np.isfinite(found.reward).all()


@every_layout
@pytest.mark.parametrize(
    ("recipe", "told"),
    [
        ("nan", r"Fake\.reset returns numbers"),
        ("over at once", r"Fake\.reset returns a step that ends the episode"),
        ("short", r"Fake returns observation of shape \(1,\), its signature says \(5,\)"),
    ],
)
def test_a_reset_that_breaks_the_signature_is_refused(layout, recipe, told):
    with make(layout, recipe) as orchestrator, pytest.raises(PluginError, match=told):
        reset(orchestrator)


def interrupt() -> None:
    raise KeyboardInterrupt


def test_an_interrupt_of_an_environment_is_told_by_its_worker():
    executor, answer = build_environments(pickle.dumps(interrupt), 1, ExitStack(), "worker 0")
    ((_, error),) = pickle.loads(answer[1:])
    assert executor is None
    assert re.fullmatch(r"worker 0: .*test_failures\.py:\d+: KeyboardInterrupt", str(error))


def test_a_lack_of_memory_says_what_to_do():
    with pytest.raises(MemoryError) as caught:
        np.empty(1 << 50)
    told = str(as_karolos_error(caught.value, "worker 0"))
    assert told.endswith("; free memory, or use fewer environments")


@every_layout
def test_after_a_failure_the_other_answers_arrive_and_a_reset_helps(layout):
    with make(layout) as orchestrator:
        reset(orchestrator)
        step(orchestrator, FINE, RAISE, FINE, FINE)
        with pytest.raises(WorkerError):
            orchestrator.receive()
        received = orchestrator.receive()
        assert received.environment.tolist() == [0, 2, 3]
        assert received.step.observation[:, 1].tolist() == [1, 1, 1]
        orchestrator.reset([1], [5])
        assert orchestrator.receive().step.observation[0, 1] == 0
        orchestrator.step([0], np.array([[RAISE]], np.float32))
        orchestrator.step([1], np.array([[SLOW]], np.float32))  # a later command of the same worker
        with pytest.raises(WorkerError, match="environment 0"):
            orchestrator.receive()
        received = orchestrator.receive()
        assert received.environment.tolist() == [1]
        assert received.step.observation[0, 1] == 1, "the step has been waited for"


@every_layout
@pytest.mark.parametrize("recipe", ["raise", "complain"])
def test_an_environment_that_cannot_be_built_says_why(layout, recipe):
    with pytest.raises(WorkerError if recipe == "raise" else PluginError) as caught:
        make(layout, recipe)
    if recipe == "raise":
        assert "RuntimeError: no such device" in str(caught.value)
        assert "and a second line" not in str(caught.value)
        assert "and a second line" in caught.value.traceback
    else:
        assert str(caught.value) == "robot.fake: the mesh is missing; install it"
    assert not multiprocessing.active_children()


@pytest.mark.parametrize(
    ("recipe", "build", "kind", "told"),
    [
        ("", Fickle, PluginError, "different observations"),
        ("die", Fake, WorkerError, "worker [01]: the worker process ended with exit code 7"),
    ],
)
def test_a_worker_that_dies_while_building_or_builds_something_else_is_reported(recipe, build, kind, told):
    with pytest.raises(kind, match=told):
        make(TWO, recipe, build)


def test_a_worker_killed_from_outside_is_noticed_while_others_are_busy():
    """Noticed at once: the other worker hangs, and would keep a parent that asks one after the other waiting."""
    with make(TWO) as orchestrator:
        pids = reset(orchestrator)
        step(orchestrator, HANG, FINE, HANG, FINE)
        threading.Timer(0.1, os.kill, (pids[2], signal.SIGKILL)).start()
        with pytest.raises(WorkerError, match="worker 1: the worker process was killed by SIGKILL"):
            orchestrator.receive()
        kill_worker(0)  # spares the timeout of close


def test_one_death_is_a_failure_of_all_threads_of_the_worker():
    with make(THREADS, failures=1) as orchestrator:
        pids = reset(orchestrator)
        os.kill(pids[0], signal.SIGKILL)
        orchestrator.reset([0], [0])
        received = orchestrator.receive()
        assert (received.environment.tolist(), received.failed.tolist()) == ([], [0, 1, 2, 3])
        assert [str(failure.error) for failure in received.failures] == [
            "worker 0: the worker process was killed by SIGKILL, with environments 0 to 3; "
            "probably out of memory: use fewer environments"
        ]
        assert len(set(reset(orchestrator))) == 1


@pytest.mark.parametrize("layout", [ONE, TWO, THREADS], ids=["1", "2", "threads"])
def test_close_ends_every_worker_and_waits_for_none_that_hangs(layout):
    orchestrator = make(layout)
    pids = reset(orchestrator)
    step(orchestrator, HANG)
    started = monotonic()
    orchestrator.close()
    assert monotonic() - started < pool.CLOSE_TIMEOUT / 2
    wait_until_gone(*pids)
    assert not multiprocessing.active_children()


def test_workers_end_when_nobody_refers_to_the_orchestrator_any_more():
    orchestrator = make(TWO)
    pids = reset(orchestrator)
    del orchestrator
    wait_until_gone(*pids)


def test_nothing_stays_open_after_close():
    make(TWO).close()  # what starts with the first and stays: the fork server
    before = sorted(os.listdir("/proc/self/fd")) if Path("/proc/self/fd").exists() else []
    with make(TWO) as orchestrator:
        reset(orchestrator)
    with pytest.raises(PluginError):
        make(TWO, "complain")
    assert (sorted(os.listdir("/proc/self/fd")) if before else []) == before


def test_an_interrupt_while_waiting_closes():
    orchestrator = make(IN_PROCESS)
    reset(orchestrator)
    step(orchestrator, INTERRUPT)
    with pytest.raises(KeyboardInterrupt):
        orchestrator.receive()
    with pytest.raises(ValueError, match="closed"):
        orchestrator.receive()


def test_a_machine_without_processes_to_give_is_a_clear_error(monkeypatch):
    monkeypatch.setattr(processes, "start_worker", _refuse)
    with pytest.raises(MachineError, match=r"worker process 0 of 2 cannot be started: .*unavailable; use fewer"):
        make(TWO)


def test_a_recipe_that_workers_cannot_import_is_refused(monkeypatch):
    with pytest.raises(PluginError, match="cannot be sent to a worker process"):
        Local(Local.Settings(), lambda: Fake(""))
    monkeypatch.setattr(fake_environments.Fake, "__module__", "__main__")
    monkeypatch.setattr(processes.sys.modules["__main__"], "Fake", Fake, raising=False)
    with pytest.raises(PluginError, match="defined in the main script"):
        make(ONE)


# With `failures`, what fails is replaced.


def reasons(received) -> list[str]:
    return [str(failure.error) for failure in received.failures]


@every_layout
def test_an_environment_that_raises_loses_its_episode_alone_and_is_built_anew_at_its_reset(layout, tmp_path):
    """Whatever state it was in when it raised."""
    built = tmp_path / "built"
    with make(layout, str(built), failures=1) as orchestrator:
        reset(orchestrator)
        step(orchestrator, FINE, RAISE, FINE, COMPLAIN)
        received = orchestrator.receive()
        assert received.environment.tolist() == [0, 2]
        assert received.step.observation[:, 1].tolist() == [1, 1]
        assert received.failed.tolist() == [1, 3]
        by_environment = {tuple(failure.environment): failure.error for failure in received.failures}
        assert "_fail_deep_inside" in by_environment[(1,)].traceback
        assert isinstance(by_environment[(3,)], PluginError)
        assert built.read_text().count("built") == 4, "nobody may want it any more"
        orchestrator.reset([1, 3], [8, 9])
        received = orchestrator.receive()
        assert (received.environment.tolist(), received.failed.size) == ([1, 3], 0)
        assert built.read_text().count("built") == 6


@every_layout
def test_failures_that_come_with_a_raised_one_are_not_lost(layout):
    with make(layout, failures=1) as orchestrator:
        reset(orchestrator)
        step(orchestrator, RAISE, FINE, FINE, FINE)
        orchestrator.receive()
        orchestrator.reset([0], [8])
        orchestrator.receive()
        step(orchestrator, RAISE, COMPLAIN, FINE, COMPLAIN)
        with pytest.raises(WorkerError):
            orchestrator.receive()
        given_up = [3] if layout == IN_PROCESS else []  # elsewhere it may not have answered yet
        orchestrator.reset(given_up, [8 for _ in given_up])
        received = orchestrator.receive()
        assert received.environment.tolist() == [2, *given_up]
        assert received.failed.tolist() == ([1] if given_up else [1, 3])


@pytest.mark.parametrize(("trouble", "name"), [(DIE, "SIGKILL"), (SEGFAULT, "SIGSEGV")])
def test_a_worker_that_dies_is_replaced_and_its_neighbours_go_on(trouble, name):
    with make(TWO, failures=1) as orchestrator:
        pids = reset(orchestrator)
        step(orchestrator, FINE, FINE, FINE, trouble)
        received = orchestrator.receive()
        assert (received.environment.tolist(), received.failed.tolist()) == ([0, 1], [2, 3])
        assert f"worker 1: the worker process was killed by {name}, with environments 2 to 3" in reasons(received)[0]
        orchestrator.reset([2, 3], [20, 30])
        orchestrator.step([0, 1], np.zeros((2, 1), np.float32))
        received = orchestrator.receive()
        assert received.environment.tolist() == [0, 1, 2, 3]
        assert received.step.observation[:, 1].tolist() == [2, 2, 0, 0]
        assert received.step.observation[:2, 0].tolist() == pids[:2]
        assert set(received.step.observation[2:, 0].tolist()).isdisjoint(pids)
        assert orchestrator.parameters([2, 3])[:, 0].tolist() == [20, 30]


def test_a_worker_that_dies_while_idle_is_named_by_the_next_answer():
    with make(TWO, failures=1) as orchestrator:
        pids = reset(orchestrator)
        kill_worker(1)
        orchestrator.step([0, 1], np.zeros((2, 1), np.float32))
        received = orchestrator.receive()
        assert (received.environment.tolist(), received.failed.tolist()) == ([0, 1], [2, 3])
        orchestrator.step([2], np.zeros((1, 1), np.float32))
        assert len(multiprocessing.active_children()) == 1, "a step of a lost episode starts no worker"
        with pytest.raises(WorkerError, match="SIGKILL, with environments 2 to 3"):
            orchestrator.receive()
        assert reset(orchestrator)[:2] == pids[:2]


def test_a_worker_that_hangs_is_killed_and_replaced():
    with make(TWO, failures=1, time_limit=0.4) as orchestrator:
        reset(orchestrator)
        step(orchestrator, FINE, FINE, HANG, FINE)
        received = orchestrator.receive()
        assert (received.environment.tolist(), received.failed.tolist()) == ([0, 1], [2, 3])
        assert reasons(received) == [
            "worker 1: a reset or step took longer than 0.4 s, with environments 2 to 3; "
            "find out why it hangs, or raise orchestrator.time_limit"
        ]
        reset(orchestrator)
        step(orchestrator, FINE, FINE, FINE, FINE)
        assert orchestrator.receive().environment.tolist() == [0, 1, 2, 3]


def test_the_time_limit_is_one_steps_and_not_all_steps_of_a_worker():
    """Four steps of .1 s each in one worker, with a limit of .3 s; nor does the time between commands count."""
    with make(ONE, time_limit=0.3) as orchestrator:
        reset(orchestrator)
        sleep(0.5)
        step(orchestrator, SLOW, SLOW, SLOW, SLOW)
        assert orchestrator.receive().environment.tolist() == [0, 1, 2, 3]


def test_building_for_ever_is_a_clear_error(monkeypatch):
    monkeypatch.setattr(pool, "BUILD_TIMEOUT", 0.3)
    with pytest.raises(WorkerError, match=r"worker 0: building an environment took longer than 0\.3 s"):
        make(ONE, "hang", time_limit=0.4)


def test_what_fails_again_and_again_ends_by_the_limit_and_an_episode_that_ends_resets_the_count():
    with make(TWO, failures=1) as orchestrator:
        for trouble in (RAISE, END, RAISE):
            reset(orchestrator)
            step(orchestrator, trouble)
            assert orchestrator.receive().failed.tolist() == ([0] if trouble == RAISE else [])
        reset(orchestrator)
        step(orchestrator, RAISE)
        with pytest.raises(WorkerError, match="ZeroDivisionError: the inertia is zero"):
            orchestrator.receive()


def test_a_replacement_that_does_not_build_is_a_failure_too(tmp_path, monkeypatch):
    with make(ONE, failures=1) as orchestrator:
        pids = reset(orchestrator)
        os.kill(pids[0], signal.SIGKILL)
        orchestrator.reset([0], [0])
        assert orchestrator.receive().failed.tolist() == [0, 1, 2, 3]
        monkeypatch.setattr(processes, "start_worker", _refuse)
        orchestrator.reset([0], [0])
        with pytest.raises(WorkerError, match="SIGKILL"):
            orchestrator.receive()


@pytest.mark.parametrize("kills", [2, 3])
def test_a_worker_killed_while_it_builds_its_first_environments_is_replaced_within_the_limit(kills, monkeypatch):
    start, killed = processes.start_worker, []

    def start_and_kill(*arguments):
        process, connections = start(*arguments)
        if len(killed) < kills:
            process.kill()
            killed.append(process)
        return process, connections

    monkeypatch.setattr(processes, "start_worker", start_and_kill)
    if kills == 3:
        with pytest.raises(WorkerError, match="SIGKILL"):
            make(ONE, "slow", failures=2)
        return
    with make(ONE, "slow", failures=2) as orchestrator:
        reset(orchestrator)
        assert len(killed) == 2
