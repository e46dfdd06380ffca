"""What is killed: a run again and again, which then ends as if it had not been; its workers, which are replaced.

Kills fall into training, testing, checkpoints and index writes alike: some time after a test. A third of them wait for
the next checkpoint to be amid its writing. Half of them hit a worker of the run, which goes on.
"""

import json
import multiprocessing
import os
import random
import signal
import subprocess
import threading
import time
from collections import Counter
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from support.listeners import Heard
from support.processes import living, wait_for
from support.states import run_differences
from support.torture import SEED, TIMES, karolos
from support.toy_runs import run_of, toy

from karolos.experiment import writer
from karolos.experiment.events import RunAdvanced
from karolos.records import RunFolder
from karolos.store import Store

PATIENCE = 15.0
"""Seconds that a killed run's workers have to notice and to end."""
AMID_CHECKPOINT = 1 / 3
"""Share of the kills that hit the writing of a checkpoint."""
TESTS = 8 if TIMES == 1 else 32
TORTURED = toy(
    agent={"precision": "float32"},
    buffer={"name": "priority", "hindsight": {"strategy": "future"}},
    orchestrator={"processes": 1 if TIMES == 1 else 2, "failures": 1000},
    training={"steps": 50 * TESTS, "replay_ratio": 8},
    testing={"interval": 50, "episodes": 4},
)


def over(process: subprocess.Popen[bytes], home: Path, tests: int, seconds: float, *, amid_checkpoint: bool) -> bool:
    """Wait; returns whether the process has ended.

    Args:
        process: executes a run in `home`.
        home: its folder of runs.
        tests: until the run has so many.
        seconds: to wait after that.
        amid_checkpoint: wait further, until a checkpoint is being written.
    """
    deadline: float | None = None
    while process.poll() is None:
        if deadline is None:
            deadline = time.monotonic() + seconds if count_tests(home) >= tests else None
            time.sleep(0.01)
        elif time.monotonic() > deadline and (not amid_checkpoint or any(home.glob("*/checkpoints/.*.new"))):
            return False
        time.sleep(0.001)
    return True


def count_tests(home: Path) -> int:
    return sum(path.read_text().count("\n") for path in home.glob("*/tests.jsonl"))


def kill_worker(process: subprocess.Popen[bytes], draw: random.Random) -> bool:
    """Kill one of the run's workers, which are grandchildren of its process; False if there is none now."""
    mine = {pid: one.parent for pid, one in living().items() if one.session == process.pid}
    workers = [pid for pid, parent in mine.items() if process.pid not in (pid, parent)]
    if not workers or process.poll() is not None:
        return False
    with suppress(ProcessLookupError):
        os.kill(draw.choice(workers), signal.SIGKILL)
        return True
    return False


def is_over(session: int) -> bool:
    """Whether no process of a session is left: none may outlive the killed run for long."""
    return session not in {one.session for one in living().values()}


def run_killed(home: Path, spec: Path, kills: int, draw: random.Random, hit: Counter[str]) -> RunFolder:
    """A run that is killed, and resumed until it is finished. `hit` counts the kills, of runs and of workers."""
    while True:
        folders = [path.parent for path in home.glob("*/run.json")]
        command = ("resume", str(folders[0])) if folders else ("run", str(spec))
        # in a session of its own, so that a kill reaches the parent alone and orphans can be seen
        process = karolos(*command, "--runs", str(home), "--quiet", stderr=subprocess.PIPE, start_new_session=True)
        while True:
            goes_on, tests = hit.total() < kills, count_tests(home)
            until = draw.randint(tests, (tests + TESTS) // 2) if goes_on else 10**9
            amid_checkpoint = goes_on and draw.random() < AMID_CHECKPOINT
            if over(process, home, until, draw.uniform(0, 0.2), amid_checkpoint=amid_checkpoint):
                assert process.stderr is not None
                assert process.returncode == 0, process.stderr.read().decode()
                return RunFolder.open(next(home.glob("*/run.json")).parent)
            if hit["workers"] <= hit["runs"]:
                hit["workers"] += kill_worker(process, draw)
                continue
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
            wait_for(partial(is_over, process.pid), PATIENCE)
            hit["runs"] += 1
            break


def test_a_run_killed_at_random_moments_ends_like_one_that_nobody_disturbed(tmp_path):
    """Nothing is lost, neither a test nor a bit; and no process outlives the killed one for long."""
    (spec := tmp_path / "torture.yaml").write_text(json.dumps(TORTURED))
    reference, draw, hit, runs = run_of(TORTURED, tmp_path / "whole"), random.Random(SEED), Counter[str](), 0
    while hit.total() < 2 * TIMES:
        runs, home = runs + 1, tmp_path / str(runs)
        folder = run_killed(home, spec, 2 * TIMES, draw, hit)
        print(f"{dict(hit)} killed in {runs} runs, {folder.state().attempt} attempts", flush=True)
        assert run_differences(folder, reference, Store.default_url(home)) == []


LEARNS: dict[str, Any] = {
    "name": "toy",
    "environment": {"name": "toy", "threshold": 0.3, "reward": "dense"},
    "agent": {"name": "sac", "hidden": [32], "precision": "float32", "discount": 0.9, "learning_rate": 3e-3},
    "buffer": {"capacity": 4000},
    "orchestrator": {"processes": 2, "environments": 2},
    "training": {"steps": 2000, "batch_size": 64, "replay_ratio": 16, "warmup_episodes": 8},
    "testing": {"interval": 1000, "episodes": 20},
}
"""Undisturbed it reaches 1.0 within 1500 steps."""


def workers() -> list[Any]:
    return [child for child in multiprocessing.active_children() if child.name.startswith("worker")]


def test_an_asynchronous_run_whose_workers_are_killed_reaches_what_an_undisturbed_one_reaches(tmp_path, monkeypatch):
    """One worker, of training or of the tests, is killed every 350 steps, amid the work."""
    monkeypatch.setattr(writer, "ADVANCE_SECONDS", 0.0)  # it is heard of after each round, however fast it is
    heard, killed, due, draw, before = Heard(), list[int](), [350], random.Random(0), shared_memory()

    def kill() -> None:
        victim = draw.choice(sorted(workers(), key=lambda child: child.pid))
        os.kill(victim.pid, signal.SIGKILL)
        killed.append(victim.pid)

    def listen(event: object) -> None:
        heard(event)
        if isinstance(event, RunAdvanced) and event.steps >= due[-1]:
            due.append(event.steps + 350)
            threading.Timer(draw.uniform(0, 0.01), kill).start()

    folder = run_of(toy(LEARNS, training={"mode": "async"}), tmp_path, listener=listen)
    assert folder.state().state == "finished"
    assert len(killed) >= 3
    assert sum("SIGKILL" in warning for warning in heard.warnings) >= 2
    assert folder.tests()[-1].success_any >= 0.9
    told = [event for event in folder.events() if event["event"] == "warning"]
    assert len(told) == len(heard.warnings)
    assert not workers()
    assert shared_memory() <= before


def test_the_comparison_sees_that_runs_of_two_seeds_differ(tmp_path):
    one, other = (run_of(toy(seeds=[seed]), tmp_path) for seed in (0, 1))
    found = run_differences(one, other, Store.default_url(tmp_path))
    assert any(path.startswith("last.agent.critic") for path in found)
    assert "episodes.jsonl" in found
    assert run_differences(one, one, Store.default_url(tmp_path)) == []


def shared_memory() -> set[str]:
    """The machine's named blocks of Python's."""
    shm = Path("/dev/shm")
    return {path.name for path in shm.glob("psm_*")} if shm.is_dir() else set()
