"""The short version of ray_cluster.py, and a cluster that loses its head; where Ray is installed."""

import time
from pathlib import Path

import pytest

from karolos.records import RunFolder, checkpoint


def test_runs_of_two_machines_of_which_one_is_killed_equal_runs_of_this_machine(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    from ray_cluster import torture

    assert torture(tmp_path, 6, 2, 0.0, steps=600, kills=1) == []


def test_runs_of_a_cluster_that_loses_its_head_stop_with_a_checkpoint_and_leave_no_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster
    from ray_cluster import SPEC, ancestors, karolos

    spec, runs = tmp_path / "spec.yaml", tmp_path / "runs"
    spec.write_text(SPEC.replace("STEPS", "1000000").replace("SEEDS", "[0, 1]").replace("processes: 0", "processes: 1"))
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    try:
        with monkeypatch.context() as environment:
            environment.setenv("RAY_gcs_rpc_server_reconnect_timeout_s", "5")  # instead of 60
            node = cluster.add_node(num_cpus=2).all_processes["raylet"][0].process
        command = karolos(
            "run", str(spec), "--on", "ray", f"launcher.address={cluster.address}", "--runs", str(runs), "--quiet"
        )
        while len(list(runs.glob("*/tests.jsonl"))) < 2:
            assert command.poll() is None
            time.sleep(0.1)
        theirs = [path for path in Path("/proc").glob("[0-9]*") if node.pid in ancestors(int(path.name))]
        assert len(theirs) >= 6  # of each run: Ray's worker, the run and its worker
        cluster.head_node.kill_all_processes(check_alive=False, allow_graceful=False)
        assert command.wait(60) == 3
        until = time.monotonic() + 60
        while any(path.exists() for path in theirs) and time.monotonic() < until:
            node.poll()  # as a process that ends is waited for on a machine of its own
            time.sleep(0.1)
        assert not [path for path in theirs if path.exists()]
    finally:
        cluster.shutdown()
    for folder in (RunFolder.open(path.parent) for path in runs.glob("*/run.json")):
        assert folder.state().state == "stopped"
        assert checkpoint.read_meta(folder.checkpoints, "last")["steps"] == folder.state().steps
