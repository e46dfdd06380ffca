"""What the Ray launcher refuses. tests/torture/test_ray_cluster.py has runs on several machines."""

from __future__ import annotations

import signal

import pytest

from karolos.errors import MachineError, UsageError
from karolos.launchers.ray import Ray, execute


def test_more_cores_than_any_machine_has_are_refused_and_signals_stay_ours() -> None:
    pytest.importorskip("ray")
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(UsageError, match=r"launcher.cpus: a run needs 999 CPUs, and no machine"):
        Ray(Ray.Settings(cpus=999, address="local"))
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_cluster_that_does_not_answer_is_named() -> None:
    pytest.importorskip("ray")
    for address in ("127.0.0.1:1", "ray://127.0.0.1:1"):
        with pytest.raises(MachineError, match=f"no Ray cluster answers at {address}: .* refused"):
            Ray(Ray.Settings(address=address))


def test_a_machine_that_does_not_see_the_folder_says_so(tmp_path) -> None:
    assert "cannot see" in str(execute(str(tmp_path / "runs" / "toy"), 1))
