"""Kill machines of a Ray cluster while it executes runs, and see that no run is lost, started twice or different.

    python tests/torture/ray_cluster.py [--runs 40] [--nodes 3] [--seconds 30] [--steps 6000] [--folder DIR]

The machines are processes of this one (ray.cluster_utils). A machine other than the head is killed as soon as it
executes a run that has tested, and again every so many seconds; another one takes its place. Each run is compared with
an undisturbed one of the local launcher: weights, buffer, counters and generators, tests, episodes, and the database.
Ends with 1 at a difference.
"""

from __future__ import annotations

import argparse
import contextlib
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from kill_resume import differences_of
from ray.cluster_utils import Cluster

from karolos.records import RunFolder
from karolos.store import Store, check

CPUS = 2
"""Of each machine, and so its number of runs at the same time."""
SPEC = """
name: toy
environment: toy
agent: {name: sac, hidden: [8]}
buffer: {name: priority, capacity: 1000}
orchestrator: {processes: 0, environments: 2}
training: {steps: STEPS, batch_size: 8, replay_ratio: 4, warmup_episodes: 2}
testing: {interval: 200, episodes: 2}
seeds: SEEDS
"""


def karolos(*arguments: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", "karolos_cli", *arguments], stdout=subprocess.DEVNULL)


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


def torture(home: Path, runs: int, nodes: int, seconds: float, *, steps: int, kills: int | None = None) -> list[str]:
    """What differs from what is promised. `kills` is the largest number of kills."""
    home.mkdir(parents=True, exist_ok=True)
    spec, folder, same = home / "spec.yaml", home / "ray", home / "undisturbed"
    spec.write_text(SPEC.replace("STEPS", str(steps)).replace("SEEDS", str(list(range(runs)))))
    undisturbed = karolos("run", str(spec), "--runs", str(same), "--jobs", "2", "--quiet")
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": CPUS, "include_dashboard": False})
    try:
        others = [cluster.add_node(num_cpus=CPUS) for _ in range(nodes - 1)]
        draw, killed, began, last = random.Random(0), 0, time.monotonic(), 0.0
        settings = (f"launcher.address={cluster.address}", "launcher.max_retries=100")
        process = karolos("run", str(spec), *settings, "--on", "ray", "--runs", str(folder), "--quiet")
        while process.poll() is None:
            is_due = killed != kills and time.monotonic() - last >= seconds
            busy = [node for node in others if executes_tested_run(node, folder)] if is_due else []
            if busy:
                others.remove(victim := draw.choice(busy))
                cluster.remove_node(victim, allow_graceful=False)
                killed, last = killed + 1, time.monotonic()
                others.append(cluster.add_node(num_cpus=CPUS))
            time.sleep(0.05)
        took = time.monotonic() - began
    finally:
        cluster.shutdown()
    undisturbed.wait()
    found, expected = ([RunFolder.open(path.parent) for path in sorted(at.glob("*/run.json"))] for at in (folder, same))
    resumed = sum(run.state().attempt > 1 for run in found)
    print(f"{runs} runs in {took:.0f} s, {killed} machines killed, {resumed} runs resumed", flush=True)
    problems = [] if resumed else ["no machine with a run was killed"]
    if process.returncode or undisturbed.returncode:
        problems.append(f"the commands ended with {process.returncode} and {undisturbed.returncode}")
    if (seeds := sorted(run.description()["seed"] for run in found)) != list(range(runs)):
        problems.append(f"there are runs of the seeds {seeds}")
    url = Store.default_url(folder)
    with Store(url) as store:
        problems += map(str, check(store, folder))
    for seed in seeds:
        one, other = (next(run for run in at if run.description()["seed"] == seed) for at in (found, expected))
        if differing := differences_of(one, other, url):
            problems.append(f"{one.id} differs: {', '.join(differing)}")
    return problems


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--nodes", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=30.0, help="between two kills")
    parser.add_argument("--steps", type=int, default=6000, help="of each run")
    parser.add_argument("--folder", type=Path, help="where the runs go; default: a temporary folder")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        home = options.folder or Path(temporary)
        problems = torture(home, options.runs, options.nodes, options.seconds, steps=options.steps)
    print("\n".join(problems) or "every run finished once and equals the undisturbed one")
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
