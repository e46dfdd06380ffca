"""Environments in actors of a Ray cluster that is started for these tests."""

from __future__ import annotations

import sys
from functools import partial

import numpy as np
import pytest
from support import toy_runs
from support.fake_environments import DIE, FINE, HANG, RAISE, Fake
from support.layouts import reset, step

from karolos.errors import MachineError, PluginError
from karolos.launchers.experiment import Experiment
from karolos.orchestrator.ray import Ray
from karolos.records import RunFolder
from karolos.specification import spec_from_dict

RAY = toy_runs.TOY | {"orchestrator": {"name": "ray", "workers": 2, "environments": 1, "address": "local"}}


def make(recipe: str = "", **settings: float) -> Ray:
    pytest.importorskip("ray")
    chosen = Ray.Settings(workers=2, environments=2, failures=5, address="local", **settings)
    return Ray(chosen, partial(Fake, recipe))


def test_without_ray_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MachineError, match=r"Ray is not installed; pip install 'karolos\[ray\]'"):
        Ray(Ray.Settings(), partial(Fake, ""))


def test_it_is_the_same_experiment_as_local_environments() -> None:
    assert spec_from_dict(RAY).hash() == spec_from_dict(toy_runs.TOY).hash()


def test_a_worker_that_dies_or_hangs_is_replaced_and_an_environment_that_raises_is_built_again() -> None:
    with make(time_limit=8.0) as orchestrator:
        pids = reset(orchestrator)
        step(orchestrator, FINE, RAISE, FINE, DIE)
        received = orchestrator.receive()
        while received.failed.size < 3:
            received = orchestrator.receive()
        # one worker's death may be told before the other's error
        raised, died = sorted(received.failures, key=lambda failure: failure.environment[0])
        assert (received.failed.tolist(), raised.lost, died.lost) == ([1, 2, 3], False, True)
        assert "ZeroDivisionError: the inertia is zero" in str(raised.error)
        assert "with environments 2 to 3" in str(died.error)
        orchestrator.step([2], np.zeros((1, 1), np.float32))
        assert orchestrator.receive().failed.tolist() == [2], "a step cannot continue a lost episode"
        replaced = reset(orchestrator)
        assert replaced[0] == pids[0]
        assert replaced[2] not in pids
        orchestrator.step([0, 1, 2], np.array([[FINE], [FINE], [HANG]], np.float32))
        received = orchestrator.receive()
        assert (received.environment.tolist(), received.failed.tolist()) == ([0, 1], [2, 3])
        assert "a reset or step took longer than 8 s" in str(received.failures[0].error)
        assert reset(orchestrator)[2] not in replaced
        assert orchestrator.parameters([3])[:, 0].tolist() == [3]


def test_an_environment_that_cannot_be_built_is_an_error_that_names_it() -> None:
    with pytest.raises(PluginError, match="the mesh is missing"):
        make("complain")


def test_a_run_with_environments_on_ray_equals_one_in_this_process(tmp_path) -> None:
    pytest.importorskip("ray")
    (one,) = Experiment(RAY).run(tmp_path / "ray").runs
    (other,) = Experiment(toy_runs.TOY).run(tmp_path / "here").runs
    folder, same = (RunFolder.open(run.folder) for run in (one, other))
    assert [(test.steps, test.end, test.returns) for test in folder.tests()] == [
        (test.steps, test.end, test.returns) for test in same.tests()
    ]
    assert (folder.path / "episodes.jsonl").read_text() == (same.path / "episodes.jsonl").read_text()
