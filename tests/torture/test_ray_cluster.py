"""The short version of ray_cluster.py, where Ray is installed."""

from pathlib import Path

import pytest


def test_runs_of_two_machines_of_which_one_is_killed_equal_runs_of_this_machine(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    from ray_cluster import torture

    assert torture(tmp_path, 6, 2, 0.0, steps=600, kills=1) == []
