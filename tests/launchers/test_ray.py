"""What the Ray launcher refuses. tests/torture/test_ray_cluster.py has runs on several machines."""

import signal
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from karolos.errors import MachineError, UsageError
from karolos.launchers.ray import RayLauncher, hand_to_process


def test_more_cores_than_any_machine_has_are_refused_and_signals_stay_ours():
    pytest.importorskip("ray")
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(UsageError, match=r"launcher.cpus: a run needs 999 CPUs, and no machine"):
        RayLauncher(RayLauncher.Settings(cpus=999, address="local"))
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_cluster_that_does_not_answer_is_named():
    pytest.importorskip("ray")
    for address in ("127.0.0.1:1", "ray://127.0.0.1:1"):
        with pytest.raises(MachineError, match=f"no Ray cluster answers at {address}: .* refused"):
            RayLauncher(RayLauncher.Settings(address=address))


def test_the_port_of_clients_without_its_scheme_is_told_before_ray_waits_for_hours():
    with pytest.raises(UsageError, match=r"port of Ray's clients; ray://head:10001, or HOST:PORT of the head"):
        RayLauncher(RayLauncher.Settings(address="head:10001"))


def test_a_machine_that_does_not_see_the_folder_says_so(tmp_path):
    assert "cannot see" in str(hand_to_process(str(tmp_path / "runs" / "toy"), 1))


def test_a_cluster_that_is_gone_is_an_error_before_ray_ends_the_process(monkeypatch):
    ray = MagicMock()
    ray.nodes.return_value = [{"Alive": True, "Resources": {"CPU": 1.0}}]
    ray.get_runtime_context().gcs_address = "127.0.0.1:1"
    ray.wait.return_value = ([], [])
    ray.exceptions = SimpleNamespace(
        **{
            f"{name}Error": type(name, (Exception,), {})
            for name in ("RayTask", "WorkerCrashed", "ObjectLost", "NodeDied")
        },
        RayError=OSError,
    )
    monkeypatch.setitem(sys.modules, "ray", ray)
    monkeypatch.setattr("karolos.launchers.ray.CHECK_SECONDS", 0.0)
    launcher = RayLauncher(RayLauncher.Settings())
    launcher.start(Path("run"))
    assert launcher.wait(0.0) is None
    monkeypatch.setattr("karolos.launchers.ray.GONE_SECONDS", 0.0)
    with pytest.raises(MachineError, match=r"127\.0\.0\.1:1: the Ray cluster is gone; .* --resume continues"):
        launcher.wait(0.0)
