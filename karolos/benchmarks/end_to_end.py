"""Seconds from a process's start until its agent reaches, for karolos and for the peer; tests are not counted.

The process is this module itself: python -m karolos.benchmarks.end_to_end karolos|peer SEED START
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from importlib import import_module
from importlib.resources import as_file, files
from typing import Any

from ..errors import RunError
from ..spec import Spec, load_spec
from . import agent_peers
from .side_by_side import require_modules

PEER = "stable-baselines3 and panda-gym"
SUCCESS = 0.95
"""At the end of the test episodes."""
PEER_RECIPE = agent_peers.RECIPES["panda_reach_sac"]
PEER_STEPS = 30_000
"""Steps after which the peer has failed."""
INTERVAL = 500
"""Environment steps between two tests of either."""
EPISODES = 100
"""Per test of either."""


@dataclass(frozen=True)
class Found:
    """The first test with enough successes."""

    steps: int
    training: float
    """Seconds of collecting and learning."""
    whole: float
    """Seconds since the process was started, without those of tests."""


def reach(*overrides: str) -> Spec:
    """The spec specs/panda_reach.yaml, which is not part of the installed package."""
    with as_file(files(__package__) / "specs") as folder:
        own = (f"testing.interval={INTERVAL}", f"testing.episodes={EPISODES}", "testing.final_episodes=0")
        return load_spec(folder / "panda_reach_sac.yaml", (*own, *overrides))


def require_peer() -> None:
    """Raise a MachineError unless the peer is installed."""
    hint = "pip install stable-baselines3, and panda-gym with --no-deps, in an environment of its own"
    require_modules(hint, "stable_baselines3", "panda_gym")


def first_success(seed: int, *, peer: bool = False) -> Found:
    """Train in a fresh process. Raises RunError when it fails.

    The peer computes with its own default of threads, or OMP_NUM_THREADS. On cores that are in use elsewhere, one
    thread is many times faster than two that wait for each other.
    """
    who = "peer" if peer else "karolos"
    command = [sys.executable, "-m", __name__, who, str(seed), repr(time.time())]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RunError(f"{who} ended with {done.returncode}: {done.stderr.strip()[-500:]}", where=__name__)
    return Found(**json.loads(done.stdout.splitlines()[-1]))


def _karolos(seed: int, started: float) -> Found | None:
    """An ordinary run, stopped at the first test with enough successes."""
    from ..experiment.events import RunAdvanced, RunEvent, RunTested  # noqa: PLC0415  (importing is part of the start)
    from ..launchers.experiment import Experiment  # noqa: PLC0415

    startup: list[float] = []
    found: list[Found] = []

    def tell(event: RunEvent) -> None:
        if isinstance(event, RunAdvanced) and not startup:
            startup.append(time.time() - started - event.seconds)
        elif isinstance(event, RunTested) and event.result.success_end >= SUCCESS and not found:
            result = event.result
            found.append(Found(result.steps, result.seconds, startup[0] + result.seconds))
            signal.raise_signal(signal.SIGTERM)

    with tempfile.TemporaryDirectory() as runs:
        Experiment(reach(f"seeds=[{seed}]")).run(runs, listener=tell)
    return found[0] if found else None


def _peer(seed: int, started: float) -> Found | None:
    """stable-baselines3's SAC with hindsight on panda-gym's task, tested as often and on as many episodes."""
    import gymnasium  # noqa: PLC0415

    import_module("panda_gym")
    library = import_module("stable_baselines3")
    callbacks = import_module("stable_baselines3.common.callbacks")
    environment, tests = gymnasium.make("PandaReach-v3"), gymnasium.make("PandaReach-v3")
    settings = PEER_RECIPE["settings"] | agent_peers.hindsight()
    model = library.SAC("MultiInputPolicy", environment, seed=seed, device="cpu", **settings)
    startup, training_started, tested = time.time() - started, time.perf_counter(), 0.0
    found: list[Found] = []

    def step(known: dict[str, Any], _: dict[str, Any]) -> bool:
        nonlocal tested
        steps = int(known["self"].num_timesteps)
        if steps % INTERVAL:
            return True
        before = time.perf_counter()
        success = sum(agent_peers.play(model, tests, 1000 + episode)[1] for episode in range(EPISODES))
        if success >= SUCCESS * EPISODES:
            seconds = before - training_started - tested
            found.append(Found(steps, seconds, startup + seconds))
        tested += time.perf_counter() - before
        return not found

    model.learn(PEER_STEPS, callback=callbacks.ConvertCallback(step))
    return found[0] if found else None


if __name__ == "__main__":
    who, seed, started = sys.argv[1:]
    found = (_peer if who == "peer" else _karolos)(int(seed), float(started))
    if found is None:
        raise SystemExit(f"no test found {SUCCESS:g} success")
    print(json.dumps(asdict(found)))
