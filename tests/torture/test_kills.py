"""What is killed: a run again and again, which then ends as if it had not been; its workers, which are replaced."""

from __future__ import annotations

import multiprocessing
import os
import random
import signal
import threading
from pathlib import Path
from typing import Any

import pytest
from kill_resume import TOY, differences_of, torture

from karolos.experiment import events
from karolos.experiment.events import RunAdvanced, RunWarned
from karolos.launchers.experiment import Experiment
from karolos.records import RunFolder
from karolos.store import Store


def test_a_run_killed_at_random_moments_ends_like_one_that_nobody_disturbed(tmp_path: Path) -> None:
    """The short version of kill_resume.py; also that no process outlives the killed one for long."""
    spec = tmp_path / "torture.yaml"
    spec.write_text(TOY.replace("steps: 1600", "steps: 400").replace("processes: 2", "processes: 1"))
    assert torture(spec, tmp_path / "runs", kills=2, draw=random.Random(1)) >= 1


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


@pytest.fixture
def heard_always(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run is heard of after each round, however fast it is."""
    monkeypatch.setattr(events, "ADVANCE_SECONDS", 0.0)


class Killer:
    """A listener that kills one of the run's workers, training's or the tests', every so many steps, amid the work."""

    def __init__(self, interval: int) -> None:
        self.interval = interval
        self.next = interval
        self.killed = 0
        self.warnings: list[str] = []
        self._draw = random.Random(0)

    def __call__(self, event: object) -> None:
        if isinstance(event, RunWarned):
            self.warnings.append(event.warning)
        if isinstance(event, RunAdvanced) and event.steps >= self.next:
            self.next = event.steps + self.interval
            threading.Timer(self._draw.uniform(0, 0.01), self._kill).start()

    def _kill(self) -> None:
        workers = [child for child in multiprocessing.active_children() if child.name.startswith("worker")]
        victim = self._draw.choice(sorted(workers, key=lambda child: child.pid or 0))
        assert victim.pid
        os.kill(victim.pid, signal.SIGKILL)
        self.killed += 1


@pytest.mark.usefixtures("heard_always")
def test_a_run_in_lockstep_whose_workers_are_killed_ends_bit_for_bit_like_an_undisturbed_one(tmp_path: Path) -> None:
    spec = LEARNS | {"training": LEARNS["training"] | {"steps": 800}, "testing": {"interval": 400, "episodes": 4}}
    killer = Killer(interval=150)
    (disturbed,) = Experiment(spec).run(tmp_path / "killed", listener=killer).runs
    (undisturbed,) = Experiment(spec).run(tmp_path / "whole").runs
    assert killer.killed >= 3
    assert killer.warnings
    folder, reference = RunFolder.open(disturbed.folder), RunFolder.open(undisturbed.folder)
    assert differences_of(folder, reference, Store.default_url(tmp_path / "killed")) == []


@pytest.mark.usefixtures("heard_always")
def test_an_asynchronous_run_whose_workers_are_killed_reaches_what_an_undisturbed_one_reaches(tmp_path: Path) -> None:
    killer = Killer(interval=350)
    before = shared_memory()
    spec = LEARNS | {"training": LEARNS["training"] | {"mode": "async"}}
    (run,) = Experiment(spec).run(tmp_path, listener=killer).runs
    assert run.state == "finished"
    assert killer.killed >= 3
    assert sum("SIGKILL" in warning for warning in killer.warnings) >= 2
    folder = RunFolder.open(run.folder)
    assert folder.tests()[-1].success_any >= 0.9
    told = [event for event in folder.events() if event["event"] == "warning"]
    assert len(told) == len(killer.warnings)
    assert not [child for child in multiprocessing.active_children() if child.name.startswith("worker")]
    assert shared_memory() <= before


def test_the_comparison_sees_that_runs_of_two_seeds_differ(tmp_path: Path) -> None:
    short = LEARNS | {"training": LEARNS["training"] | {"steps": 200}, "testing": {"interval": 100, "episodes": 2}}
    folders = []
    for seed in (0, 1):
        (run,) = Experiment(short | {"seeds": [seed]}).run(tmp_path / str(seed)).runs
        folders.append(RunFolder.open(run.folder))
    found = differences_of(folders[0], folders[1], Store.default_url(tmp_path / "0"))
    assert any(path.startswith("last.agent.critic") for path in found)
    assert "episodes.jsonl" in found
    assert differences_of(folders[0], folders[0], Store.default_url(tmp_path / "0")) == []


def shared_memory() -> set[str]:
    """The machine's named blocks of Python's."""
    shm = Path("/dev/shm")
    return {path.name for path in shm.glob("psm_*")} if shm.is_dir() else set()
