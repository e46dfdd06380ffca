"""Runs in processes of this machine."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.processes import child_processes, wait_for
from support.toy_runs import created, toy

from karolos.errors import MachineError
from karolos.launchers.interface import COMMAND
from karolos.launchers.local import LocalLauncher
from karolos.records import RunFolder

SECONDS = 60.0
DRIVER = """
import sys, time
from pathlib import Path
from karolos.launchers import local
from karolos.launchers.ray import BETWEEN
local.COMMAND = (*BETWEEN, *local.COMMAND)
launcher = local.LocalLauncher(local.LocalLauncher.Settings())
while not launcher.room(1):
    launcher.wait(1.0)
launcher.start(Path(sys.argv[1]))
time.sleep(600)
"""


def new_run(runs: Path, seed: int = 0, steps: int = 40) -> RunFolder:
    return created(toy(training={"steps": steps}, testing={"interval": 20}), runs, seed)


def prepare(launcher: LocalLauncher) -> None:
    def ready() -> bool:
        assert launcher.wait(0.0) is None
        return bool(launcher.room(1))

    wait_for(ready, SECONDS)


def test_a_process_executes_several_runs_stops_one_by_its_file_and_is_replaced_when_it_dies(tmp_path):
    first, stopped, killed = (new_run(tmp_path, seed, steps) for seed, steps in enumerate((40, 10**6, 10**6)))
    before = set(child_processes())
    with LocalLauncher(LocalLauncher.Settings()) as launcher:
        prepare(launcher)
        (process,) = set(child_processes()) - before
        launcher.start(first.path)
        assert launcher.room(1) == 0
        assert launcher.wait(SECONDS) == (first.path, None, False)
        assert first.state().state == "finished"
        launcher.start(stopped.path)
        wait_for(stopped.tests)
        stopped.stop.write_text("pruned")
        assert launcher.wait(SECONDS) == (stopped.path, None, False)
        assert (stopped.state().state, stopped.events()[-1]["reason"]) == ("stopped", "pruned")
        launcher.start(killed.path)
        wait_for(killed.tests)
        os.kill(process, signal.SIGKILL)
        assert launcher.wait(SECONDS) == (killed.path, "its process was killed by SIGKILL", True)
        assert killed.state().state == "lost"
        assert launcher.room(1) == 0, "another process begins"
        assert set(child_processes()) - before - {process}
    assert set(child_processes()) <= before


def test_the_end_of_the_driver_stops_its_runs_with_a_checkpoint_also_behind_the_shell_of_ray(tmp_path):
    folder = new_run(tmp_path, steps=10**6)
    with subprocess.Popen([sys.executable, "-c", DRIVER, str(folder.path)]) as driver:
        wait_for(folder.tests)
        driver.kill()
    wait_for(lambda: not folder.is_locked())
    assert (folder.state().state, folder.events()[-1]["reason"]) == ("stopped", "SIGTERM")
    assert (folder.checkpoints / "last" / "manifest.json").is_file()


def test_a_process_that_ends_before_it_is_ready_is_replaced(tmp_path, monkeypatch):
    once = f'mkdir {tmp_path}/once 2>/dev/null && kill -9 $$; exec "$@"'
    monkeypatch.setattr("karolos.launchers.local.COMMAND", ("sh", "-c", once, "run", *COMMAND))
    with LocalLauncher(LocalLauncher.Settings()) as launcher:
        prepare(launcher)
        assert launcher.room(1) == 1


def test_a_process_that_ended_before_its_order_keeps_no_other_from_being_closed(tmp_path):
    before = set(child_processes())
    with LocalLauncher(LocalLauncher.Settings(), 2) as launcher:
        wait_for(lambda: launcher.wait(0.0) is None and launcher.room(2) == 2, SECONDS)
        first = launcher._processes[0].child
        first.kill()
        first.wait()
        launcher.start(tmp_path)
    assert set(child_processes()) <= before


def test_a_process_that_cannot_begin_is_an_error_that_says_how_it_ended(tmp_path, monkeypatch):
    monkeypatch.setattr("karolos.launchers.local.COMMAND", (sys.executable, "-c", "raise SystemExit(3)"))
    with (
        LocalLauncher(LocalLauncher.Settings()) as launcher,
        pytest.raises(MachineError, match="ended with exit code 3 before"),
    ):
        prepare(launcher)
