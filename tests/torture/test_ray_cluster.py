"""Machines of a Ray cluster are killed while they execute runs: no run is lost, started twice or different.

The machines are processes of this one (ray.cluster_utils).
"""

import contextlib
import json
import random
import time
from pathlib import Path
from typing import Any

import pytest
from support.states import run_differences
from support.torture import TIMES, karolos
from support.toy_runs import toy

from karolos.records import RunFolder, checkpoint
from karolos.store import Store, check

pytestmark = pytest.mark.usefixtures("real_processes")  # Ray's libraries do not survive a fork
Cluster = pytest.importorskip("ray.cluster_utils").Cluster
CPUS = 2
"""Of each machine, and so its number of runs at the same time."""
LONG = TIMES > 1
RUNS, NODES, SECONDS, STEPS = (40, 3, 30.0, 6000) if LONG else (6, 2, 0.0, 600)
"""Runs, machines, seconds between two kills, steps of each run. A short test kills one machine."""


def write_spec(folder: Path, *, runs: int, steps: int, processes: int = 0) -> Path:
    """A spec of these many seeds and steps."""
    (path := folder / "spec.yaml").write_text(
        json.dumps(
            toy(
                buffer={"name": "priority"},
                orchestrator={"processes": processes},
                training={"steps": steps},
                testing={"interval": 200},
                seeds=list(range(runs)),
            )
        )
    )
    return path


def executes_tested_run(node: Any, folder: Path) -> bool:
    """Whether a process of the machine holds the lock of a run that has tested and not ended."""
    inodes = {
        path.stat().st_ino
        for path in folder.glob("*/lock")
        if (path.parent / "tests.jsonl").exists() and RunFolder.open(path.parent).state().unfinished
    }
    # A line of a held lock: "1: FLOCK ADVISORY WRITE 4242 08:01:123456 0 EOF"; of one waited for: "1: -> FLOCK ..."
    held = [line.split() for line in Path("/proc/locks").read_text().splitlines() if "->" not in line]
    pids = {int(words[4]) for words in held if int(words[5].rpartition(":")[2]) in inodes}
    machine = node.all_processes["raylet"][0].process.pid
    return any(machine in ancestors(pid) for pid in pids)


def ancestors(pid: int) -> list[int]:
    """Parents of a process, the nearest first; none if it has ended."""
    found = []
    with contextlib.suppress(OSError):
        while pid > 1:
            # After the name in brackets: state and parent.
            pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
            found.append(pid)
    return found


def test_runs_of_machines_of_which_some_are_killed_equal_runs_of_this_machine(tmp_path):
    """A machine other than the head is killed as soon as it executes a run that has tested; another takes its place."""
    spec, folder, same = write_spec(tmp_path, runs=RUNS, steps=STEPS), tmp_path / "ray", tmp_path / "undisturbed"
    undisturbed = karolos("run", str(spec), "--runs", str(same), "--jobs", "2", "--quiet")
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": CPUS, "include_dashboard": False})
    try:
        others = [cluster.add_node(num_cpus=CPUS) for _ in range(NODES - 1)]
        draw, killed, last = random.Random(0), 0, 0.0
        settings = (f"launcher.address={cluster.address}", "launcher.max_retries=100")
        process = karolos("run", str(spec), *settings, "--on", "ray", "--runs", str(folder), "--quiet")
        while process.poll() is None:
            is_due = (LONG or killed == 0) and time.monotonic() - last >= SECONDS
            busy = [node for node in others if executes_tested_run(node, folder)] if is_due else []
            if busy:
                others.remove(victim := draw.choice(busy))
                cluster.remove_node(victim, allow_graceful=False)
                killed, last = killed + 1, time.monotonic()
                others.append(cluster.add_node(num_cpus=CPUS))
            time.sleep(0.05)
    finally:
        cluster.shutdown()
    assert (process.returncode, undisturbed.wait()) == (0, 0)
    found, expected = ({run.description()["seed"]: run for run in runs_in(at)} for at in (folder, same))
    assert any(run.state().attempt > 1 for run in found.values()), "no machine with a run was killed"
    assert sorted(run.description()["seed"] for run in runs_in(folder)) == sorted(expected) == list(range(RUNS))
    url = Store.default_url(folder)
    with Store(url) as store:
        assert list(check(store, folder)) == []
    for seed, run in found.items():
        assert run_differences(run, expected[seed], url) == []


def runs_in(folder: Path) -> list[RunFolder]:
    return [RunFolder.open(path.parent) for path in folder.glob("*/run.json")]


def test_runs_of_a_cluster_that_loses_its_head_stop_with_a_checkpoint_and_leave_no_process(tmp_path, monkeypatch):
    spec, runs = write_spec(tmp_path, runs=2, steps=1_000_000, processes=1), tmp_path / "runs"
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
    for folder in runs_in(runs):
        assert folder.state().state == "stopped"
        assert checkpoint.read_meta(folder.checkpoints, "last")["steps"] == folder.state().steps
