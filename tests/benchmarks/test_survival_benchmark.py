"""The benchmark of what runs survive, at toy size: that it kills, resumes, compares, and would see a difference."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest

from karolos.benchmarks import survival
from karolos.experiment.experiment import Experiment
from karolos.records import RunFolder
from karolos.spec import spec_from_dict
from karolos.store import Store

TOY: dict[str, Any] = {
    "environment": {"name": "toy"},
    "agent": {"name": "sac", "hidden": [8], "precision": "float32"},
    "buffer": {"name": "priority", "capacity": 2000, "hindsight": {}},
    "orchestrator": {"name": "local", "processes": 1, "environments": 4},
    "training": {"batch_size": 16, "replay_ratio": 12, "warmup_episodes": 4},
}

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="kills as POSIX does")


def test_a_killed_toy_ends_like_an_undisturbed_one_and_killed_workers_are_replaced(monkeypatch: Any) -> None:
    monkeypatch.setattr(survival, "CASES", {"toy": TOY})
    training = {**TOY["training"], "steps": 3000}
    orchestrator = {**TOY["orchestrator"], "failures": 1000}
    small = spec_from_dict({**TOY, "name": "toy", "training": training, "orchestrator": orchestrator})
    monkeypatch.setattr(survival, "reach", lambda *_: small)
    said: list[str] = []
    killed, workers = survival.measure(steps=3000, seconds=1.0, say=said.append)
    assert killed.value == 0
    assert any("killed after" in line and "equal" in line for line in said)
    assert workers.peer == "undisturbed"
    assert "(0 of them)" not in workers.case


def test_runs_of_two_seeds_differ(tmp_path: Path) -> None:
    parts = {**TOY, "training": {**TOY["training"], "steps": 200}, "testing": {"interval": 100, "episodes": 2}}
    folders = []
    for seed in (0, 1):
        (run,) = Experiment(spec_from_dict({**parts, "name": "toy", "seeds": [seed]})).run(tmp_path / str(seed)).runs
        folders.append(RunFolder.open(run.folder))
    found = survival.differences_of(folders[0], folders[1], Store.default_url(tmp_path / "0"))
    assert any(path.startswith("last.agent.critic") for path in found)
    assert "episodes.jsonl" in found
    assert survival.differences_of(folders[0], folders[0], Store.default_url(tmp_path / "0")) == []
