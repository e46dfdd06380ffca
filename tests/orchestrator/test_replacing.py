"""What fails is replaced and named, and its neighbours go on; what goes on failing ends the run."""

import multiprocessing
import os
import signal
from functools import partial
from time import sleep

import numpy as np
import pytest
from support.fake_environments import COMPLAIN, DIE, END, FINE, HANG, RAISE, SEGFAULT
from support.layouts import IN_PROCESS, ONE, THREADS, TWO, make, reset, step
from support.processes import kill_worker

from karolos.environments.toy import Toy
from karolos.errors import MachineError, PluginError, WorkerError
from karolos.orchestrator import pool, processes
from karolos.orchestrator.local import Local

every_layout = pytest.mark.parametrize("layout", [IN_PROCESS, ONE, TWO, THREADS], ids=["0", "1", "2", "threads"])


def reasons(received) -> list[str]:
    return [str(failure.error) for failure in received.failures]


@every_layout
def test_an_environment_that_raises_loses_its_episode_alone(layout):
    with make(layout, failures=1) as orchestrator:
        reset(orchestrator)
        step(orchestrator, FINE, RAISE, FINE, COMPLAIN)
        received = orchestrator.receive()
        assert received.environment.tolist() == [0, 2]
        assert received.step.observation[:, 1].tolist() == [1, 1]
        assert received.failed.tolist() == [1, 3]
        by_environment = {tuple(failure.environment): failure.error for failure in received.failures}
        assert "_fail_deep_inside" in by_environment[(1,)].traceback
        assert isinstance(by_environment[(3,)], PluginError)
        orchestrator.reset([1, 3], [8, 9])
        received = orchestrator.receive()
        assert (received.environment.tolist(), received.failed.size) == ([1, 3], 0)


@every_layout
def test_an_environment_that_raised_is_built_anew_at_its_reset(layout, tmp_path):
    """Whatever state it was in when it raised."""
    built = tmp_path / "built"
    with make(layout, str(built), failures=2) as orchestrator:
        reset(orchestrator)
        assert built.read_text().count("built") == 4
        step(orchestrator, FINE, RAISE, FINE, FINE)
        assert orchestrator.receive().failed.tolist() == [1]
        assert built.read_text().count("built") == 4, "nobody may want it any more"
        reset(orchestrator)
        assert built.read_text().count("built") == 5


@pytest.mark.parametrize("trouble", [DIE, SEGFAULT])
def test_a_worker_that_dies_is_replaced_and_its_neighbours_go_on(trouble):
    with make(TWO, failures=1) as orchestrator:
        pids = reset(orchestrator)
        step(orchestrator, FINE, FINE, FINE, trouble)
        received = orchestrator.receive()
        assert (received.environment.tolist(), received.failed.tolist()) == ([0, 1], [2, 3])
        assert "with environments 2 to 3" in reasons(received)[0]
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
        assert len(multiprocessing.active_children()) == 1, (
            "a step cannot go on with a lost episode, and starts no worker"
        )
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


def test_the_time_limit_is_one_steps_and_not_all_steps_of_a_worker(monkeypatch):
    """Four steps of .1 s each in one worker, with a limit of .3 s; nor does the time between commands count."""
    from support.fake_environments import SLOW

    with make(ONE, time_limit=0.3) as orchestrator:
        reset(orchestrator)
        sleep(0.5)
        step(orchestrator, SLOW, SLOW, SLOW, SLOW)
        assert orchestrator.receive().environment.tolist() == [0, 1, 2, 3]


def test_building_for_ever_is_a_clear_error(monkeypatch):
    monkeypatch.setattr(pool, "BUILD_TIMEOUT", 0.3)
    with pytest.raises(WorkerError, match=r"worker 0: building an environment took longer than 0\.3 s"):
        make(ONE, "hang", time_limit=0.4)


@every_layout
def test_what_fails_at_once_again_ends_by_the_limit_with_its_traceback(layout):
    with make(layout, failures=2) as orchestrator:
        reset(orchestrator)
        for _ in range(2):
            step(orchestrator, RAISE)
            assert orchestrator.receive().failed.tolist() == [0]
            orchestrator.reset([0], [0])
            orchestrator.receive()
        step(orchestrator, RAISE)
        with pytest.raises(WorkerError, match="ZeroDivisionError: the inertia is zero") as caught:
            orchestrator.receive()
        assert "_fail_deep_inside" in caught.value.traceback


def test_an_episode_that_ends_makes_the_count_begin_anew():
    with make(TWO, failures=1) as orchestrator:
        for _ in range(3):
            reset(orchestrator)
            step(orchestrator, RAISE)
            assert orchestrator.receive().failed.tolist() == [0]
            reset(orchestrator)
            step(orchestrator, END)
            assert orchestrator.receive().step.truncated.tolist() == [True]


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


def _refuse(*_: object) -> None:
    raise BlockingIOError(11, "Resource temporarily unavailable")


def test_a_machine_that_gives_no_worker_at_the_start_is_a_clear_error(monkeypatch):
    monkeypatch.setattr(processes, "start_worker", _refuse)
    with pytest.raises(MachineError, match="worker process 0 of 2 cannot be started"):
        make(TWO)


def test_episodes_after_a_replacement_are_what_they_would_have_been():
    settings = Toy.Settings(dimensions=3, max_steps=5, reward="dense", threshold=0.3)
    played = []
    for kill in (False, True):
        with Local(Local.Settings(processes=2, environments=2, failures=1), partial(Toy, settings)) as orchestrator:
            orchestrator.reset(range(4), range(4))
            orchestrator.receive()
            if kill:
                kill_worker(0)
                orchestrator.step([0], np.zeros((1, 3), np.float32))
                assert orchestrator.receive().failed.tolist() == [0, 1]
            orchestrator.reset(range(4), range(4))
            orchestrator.receive()
            orchestrator.step(range(4), np.full((4, 3), 0.5, np.float32))
            played.append(orchestrator.receive().step)
    for ours, theirs in zip(*played, strict=True):
        np.testing.assert_array_equal(ours, theirs)
