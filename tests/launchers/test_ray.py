"""Runs on a Ray cluster, of which all machines are processes of this one."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from karolos.errors import MachineError, UsageError
from karolos.experiment.experiment import Experiment
from karolos.launchers.ray import Ray
from karolos.records import RunFolder
from karolos.store import Store, check

TOY: dict[str, Any] = {
    "name": "toy",
    "environment": "toy",
    "agent": {"name": "sac", "hidden": [8]},
    "orchestrator": {"processes": 0, "environments": 2},
    "training": {"steps": 400, "batch_size": 8, "replay_ratio": 4, "warmup_episodes": 2},
    "testing": {"interval": 100, "episodes": 2},
}


def test_without_ray_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MachineError, match=r"Ray is not installed; pip install 'karolos\[ray\]'"):
        Ray(Ray.Settings())


def test_runs_of_two_machines_of_which_one_is_killed_equal_runs_of_this_process(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    second = cluster.add_node(num_cpus=2)
    spec = TOY | {"seeds": list(range(6)), "launcher": {"name": "ray", "address": cluster.address}}

    def kill() -> None:
        until = time.monotonic() + 120
        while len(list((tmp_path / "ray").glob("*/tests.jsonl"))) < 2 and time.monotonic() < until:
            time.sleep(0.05)
        cluster.remove_node(second, allow_graceful=False)

    killer = threading.Thread(target=kill)
    try:
        with pytest.raises(UsageError, match="needs 9 CPUs, and no machine of the cluster has more than 2"):
            Ray(Ray.Settings(cpus=9, address=cluster.address))
        killer.start()
        outcome = Experiment(spec).run(tmp_path / "ray", check=False)
        killer.join()
    finally:
        cluster.shutdown()
    assert [(run.seed, run.state, run.error) for run in outcome.runs] == [(seed, "finished", None) for seed in range(6)]
    assert len(list((tmp_path / "ray").glob("toy-*"))) == 6
    with Store(Store.default_url(tmp_path / "ray")) as store:
        assert list(check(store, tmp_path / "ray")) == []
    here = Experiment(TOY | {"seeds": list(range(6))}).run(tmp_path / "here")
    for one, other in zip(outcome.runs, here.runs, strict=True):
        tests, same = (RunFolder.open(run.folder).tests() for run in (one, other))
        assert [(test.steps, test.end, test.returns) for test in tests] == [
            (test.steps, test.end, test.returns) for test in same
        ]
