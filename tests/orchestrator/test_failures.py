"""What reaches the user when an environment, a worker or the machine fails, and what is left behind: nothing."""

import multiprocessing
import os
import signal
import threading
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest
from support import fake_environments
from support.fake_environments import (
    COMPLAIN,
    DIE,
    EXIT,
    FINE,
    HANG,
    INTERRUPT,
    QUIRKY,
    RAISE,
    SEGFAULT,
    SLOW,
    Fake,
    Fickle,
)
from support.layouts import IN_PROCESS, ONE, THREADS, TWO, make, reset, step
from support.processes import kill_worker

from karolos.errors import KarolosError, MachineError, PluginError, WorkerError
from karolos.orchestrator import pool, processes, start
from karolos.orchestrator.local import Local

every_layout = pytest.mark.parametrize("layout", [IN_PROCESS, ONE, TWO, THREADS], ids=["0", "1", "2", "threads"])


def wait_until_gone(*pids: int) -> None:
    deadline = monotonic() + 20
    while any(is_alive(pid) for pid in pids):
        assert monotonic() < deadline, f"still there: {[pid for pid in pids if is_alive(pid)]}"
        sleep(0.02)


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat")
    return not (state.exists() and state.read_text().rpartition(")")[2].split()[0] == "Z")


@every_layout
def test_an_exception_in_a_step_arrives_with_its_traceback(layout):
    with make(layout) as orchestrator:
        reset(orchestrator)
        step(orchestrator, FINE, FINE, RAISE, FINE)
        with pytest.raises(WorkerError) as caught:
            orchestrator.receive()
    assert "ZeroDivisionError: the inertia is zero" in str(caught.value)
    assert "environment 2" in str(caught.value.where)
    assert "_fail_deep_inside" in caught.value.traceback
    assert "\n" not in str(caught.value)


@every_layout
def test_an_error_made_for_people_arrives_as_it_is(layout):
    with make(layout) as orchestrator:
        reset(orchestrator)
        step(orchestrator, FINE, COMPLAIN)
        with pytest.raises(PluginError) as caught:
            orchestrator.receive()
    assert str(caught.value) == "robot.fake: the gripper has three fingers; give it two"


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
        step(orchestrator, FINE, FINE, FINE, FINE)
        assert orchestrator.receive().step.observation[:, 1].tolist() == [2, 1, 2, 2]


@every_layout
def test_a_failure_leaves_later_commands_of_the_same_worker_pending(layout):
    with make(layout) as orchestrator:
        reset(orchestrator)
        orchestrator.step([0], np.array([[RAISE]], np.float32))
        orchestrator.step([1], np.array([[SLOW]], np.float32))
        with pytest.raises(WorkerError, match="environment 0"):
            orchestrator.receive()
        received = orchestrator.receive()
        assert received.environment.tolist() == [1]
        assert received.step.observation[0, 1] == 1, "the step has been waited for"


@every_layout
def test_each_failure_is_reported_once(layout):
    with make(layout) as orchestrator:
        reset(orchestrator)
        step(orchestrator, RAISE, FINE, FINE, COMPLAIN)
        with pytest.raises(KarolosError):
            orchestrator.receive()
        received: list[int] = []
        while not received:  # the second error comes along with the first, or after it from another worker
            try:
                received = orchestrator.receive().environment.tolist()
            except KarolosError:
                continue
        assert received == [1, 2]


@every_layout
def test_a_plugin_that_exits_is_an_error_and_not_the_end(layout):
    with make(layout) as orchestrator:
        reset(orchestrator)
        step(orchestrator, EXIT)
        with pytest.raises(WorkerError, match="SystemExit: enough"):
            orchestrator.receive()


@every_layout
def test_a_plugins_own_kind_of_error_keeps_its_words(layout):
    with make(layout) as orchestrator:
        reset(orchestrator)
        step(orchestrator, QUIRKY)
        with pytest.raises(KarolosError, match="quirky; do not"):
            orchestrator.receive()


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


@every_layout
def test_an_environment_that_breaks_its_signature_is_refused(layout):
    with make(layout, "short") as orchestrator:
        orchestrator.reset([0], [0])
        with pytest.raises(PluginError, match=r"Fake returns observation of shape \(1,\), its signature says \(5,\)"):
            orchestrator.receive()


def test_workers_whose_environments_differ_are_refused():
    with pytest.raises(PluginError, match="different observations"):
        make(TWO, build=Fickle)


def test_a_worker_that_dies_while_building_is_reported():
    with pytest.raises(WorkerError, match=r"worker [01]: the worker process ended with exit code 7"):
        make(TWO, "die")


@pytest.mark.parametrize(("trouble", "name"), [(DIE, "SIGKILL"), (SEGFAULT, "SIGSEGV")])
def test_a_worker_that_dies_is_reported_with_its_environments(trouble, name):
    with make(TWO) as orchestrator:
        reset(orchestrator)
        step(orchestrator, FINE, FINE, FINE, trouble)
        with pytest.raises(WorkerError, match=f"worker 1: .* killed by {name}, with environments 2 to 3"):
            orchestrator.receive()
        assert orchestrator.receive().environment.tolist() == [0, 1]
        step(orchestrator, FINE, FINE)
        assert orchestrator.receive().environment.tolist() == [0, 1], "its neighbours go on"
        orchestrator.reset([2, 3], [20, 30])
        assert orchestrator.receive().environment.tolist() == [2, 3], "another worker stands in for it"


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
def test_close_ends_every_worker_also_those_that_hang(layout, monkeypatch):
    monkeypatch.setattr(pool, "CLOSE_TIMEOUT", 0.2)
    orchestrator = make(layout)
    pids = reset(orchestrator)
    step(orchestrator, HANG)
    orchestrator.close()
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
    def refuse(*_: object) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(processes, "start_worker", refuse)
    with pytest.raises(MachineError, match=r"worker process 0 of 2 cannot be started: .*unavailable; use fewer"):
        make(TWO)


def test_a_recipe_that_workers_cannot_import_is_refused(monkeypatch):
    with pytest.raises(PluginError, match="cannot be sent to a worker process"):
        Local(Local.Settings(), lambda: Fake(""))
    monkeypatch.setattr(fake_environments.Fake, "__module__", "__main__")
    monkeypatch.setattr(start.sys.modules["__main__"], "Fake", Fake, raising=False)
    with pytest.raises(PluginError, match="defined in the main script"):
        make(ONE)
