"""What a run survives: a kill half-way, and kills of its workers again and again.

A killed and resumed run is compared with an undisturbed one bit for bit: weights, buffer, counters and random streams
of the last checkpoint, tests, training episodes, and the rows in the database.
"""

from __future__ import annotations

import json
import multiprocessing
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from .. import checkpoint
from ..errors import MachineError, RunError
from ..experiment.events import Listener, RunEvent
from ..experiment.experiment import Experiment
from ..plugins.contracts.case import state_differences
from ..records import RunFolder
from ..spec import Spec
from ..store import Store
from .end_to_end import reach
from .side_by_side import Row

STEPS = 50_000
TESTS = 5
"""Tests of a run that is killed; the kill comes after half of its steps."""
BETWEEN_KILLS = 2.0
"""Seconds from one killed worker to the next."""
CASES: dict[str, dict[str, Any]] = {
    "sac, priority, hindsight, PandaPickPlace, 2 processes": {
        "robot": {"name": "panda", "control": "cartesian"},
        "task": {"name": "pick_place", "reward": "sparse"},
        "agent": {"name": "sac", "learning_rate": 1e-3, "discount": 0.95, "layer_norm": True, "policy_delay": 2},
        "buffer": {"name": "priority", "capacity": 1_000_000, "hindsight": {"strategy": "future", "ratio": 0.8}},
        "orchestrator": {"name": "local", "processes": 2, "environments": 32},
        "training": {"batch_size": 256, "replay_ratio": 16, "warmup_episodes": 32},
    },
    "ppo, PandaReach": {
        "robot": {"name": "panda", "control": "cartesian"},
        "task": {"name": "reach", "reward": "dense"},
        "agent": {"name": "ppo", "discount": 0.95},
        "buffer": {"name": "on_policy", "rollout": 50},
        "orchestrator": {"name": "local", "processes": 1, "environments": 8},
    },
}


def measure(
    *, steps: int = STEPS, seconds: float = BETWEEN_KILLS, say: Callable[[str], object] = lambda _: None
) -> Iterator[Row]:
    """Differences between a killed run and an undisturbed one, and the success of a run whose workers are killed.

    Args:
        steps: of the runs that are killed.
        seconds: between two killed workers.
        say: receives a line about each event.

    Raises:
        MachineError: this system cannot kill as POSIX does.
        RunError: a run failed.
    """
    if not hasattr(signal, "SIGKILL"):
        raise MachineError("this system has no SIGKILL", hint="measure on Linux or macOS")
    with tempfile.TemporaryDirectory() as temporary:
        for number, (case, parts) in enumerate(CASES.items()):
            found = _killed(case, parts, steps, Path(temporary) / str(number), say)
            yield Row("survival", f"{case}: {steps:,} steps, killed half-way", float(len(found)), "differences")
        yield _workers_killed(Path(temporary) / "workers", seconds, say)


def _killed(case: str, parts: Mapping[str, Any], steps: int, home: Path, say: Callable[[str], object]) -> list[str]:
    """Differences between the killed and resumed run and the undisturbed one."""
    home.mkdir(parents=True)
    training = {**parts.get("training", {}), "steps": steps}
    testing = {"interval": max(steps // TESTS, 1), "episodes": 20, "final_episodes": 0}
    spec = home / "survival.yaml"
    spec.write_text(json.dumps({"name": "survival", **parts, "training": training, "testing": testing}), "utf-8")
    undisturbed = _run(home / "undisturbed", spec)
    say(f"{case}: undisturbed in {undisturbed.state().seconds:.0f} s")
    process = _start("run", str(spec), "--runs", str(home / "killed"))
    while process.poll() is None and _steps(home / "killed") < steps // 2:
        time.sleep(0.05)
    time.sleep(random.Random(0).uniform(0.2, 1.0))  # into the training that follows a test
    if process.poll() is not None:
        raise RunError(f"the run ended with {process.returncode} before it was killed", where=case)
    process.kill()
    process.wait()
    reached = _steps(home / "killed")
    killed = _run(home / "killed", None)
    found = differences_of(killed, undisturbed, Store.default_url(home / "killed"))
    say(f"{case}: killed after {reached:,} steps and resumed; {', '.join(found) or 'equal'}")
    return found


def _start(*arguments: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "karolos_cli", *arguments, "--quiet"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def _run(home: Path, spec: Path | None) -> RunFolder:
    """Run the spec, or without one resume the run in `home`. Raises RunError where that fails."""
    arguments = ("run", str(spec)) if spec else ("resume", str(next(home.glob("*/run.json")).parent))
    process = _start(*arguments, "--runs", str(home))
    errors = process.communicate()[1].decode()
    if process.returncode:
        raise RunError(errors.strip().splitlines()[-1] if errors.strip() else "a run failed", where="survival")
    return RunFolder.open(next(home.glob("*/run.json")).parent)


def _steps(home: Path) -> int:
    """Steps of the run in `home`, as its state file says; 0 before there is one."""
    folder = next(iter(home.glob("*/run.json")), None)
    return RunFolder.open(folder.parent).state().steps if folder else 0


def _workers_killed(home: Path, seconds: float, say: Callable[[str], object]) -> Row:
    """The success of a run whose workers are killed, beside that of an undisturbed one."""
    spec = reach("orchestrator.processes=2", "orchestrator.failures=1000", "testing.interval=3000")
    undisturbed = _success(spec, home / "undisturbed")
    draw, killed, last = random.Random(0), 0, time.monotonic()

    def kill(_: RunEvent) -> None:  # in the thread that starts workers, because multiprocessing is not thread-safe
        nonlocal killed, last
        workers = [child for child in multiprocessing.active_children() if child.name.startswith("worker")]
        if workers and time.monotonic() - last >= seconds:
            draw.choice(sorted(workers, key=lambda child: child.pid or 0)).kill()
            killed, last = killed + 1, time.monotonic()

    disturbed = _success(spec, home / "killed", kill)
    say(f"{killed} workers killed")
    case = f"PandaReach, a worker killed every {seconds:g} s ({killed} of them)"
    return Row("survival", case, disturbed, "success", "undisturbed", undisturbed)


def _success(spec: Spec, home: Path, listener: Listener | None = None) -> float:
    (run,) = Experiment(spec).run(home, listener=listener).runs
    if run.state != "finished":
        raise RunError(f"the run is {run.state}: {run.error}", where="survival")
    return RunFolder.open(run.folder).tests()[-1].success_end


def differences_of(folder: RunFolder, reference: RunFolder, database: str) -> list[str]:
    """Differences between a run and an undisturbed one of the same spec and seed, except the seconds they took.

    Args:
        folder: of the run.
        reference: folder of the undisturbed run.
        database: URL of the index that holds the run.
    """
    one, other = (checkpoint.load(run.checkpoints, "last")[0] for run in (folder, reference))
    found = state_differences(one, other, ignore=frozenset({"seconds"}), path="last")
    tests = [(test.steps, test.any, test.end, test.returns) for test in folder.tests()]
    if tests != [(test.steps, test.any, test.end, test.returns) for test in reference.tests()]:
        found.append("tests.jsonl")
    if (folder.path / "episodes.jsonl").read_text() != (reference.path / "episodes.jsonl").read_text():
        found.append("episodes.jsonl")
    with Store(database) as store:
        stored = [(test.steps, test.any, test.end) for test in store.tests(folder.id)]
        if stored != [(test.steps, sum(test.any), sum(test.end)) for test in folder.tests()]:
            found.append(f"tests in the database: {stored}")
        if store.find(folder.id) != folder.summary():
            found.append("the run's row in the database")
    return found
