"""How fast karolos's environments step beside panda-gym's, both by gymnasium's interface, in one run."""

from __future__ import annotations

from importlib.util import find_spec
from statistics import median
from time import perf_counter, thread_time
from typing import Any

import numpy as np

from ..errors import MachineError
from .row import Row

PEER = "panda-gym"
TASKS = {
    "reach": ("karolos/PandaReach-v1", "PandaReach-v3"),
    "pick_place": ("karolos/PandaPickPlace-v1", "PandaPickAndPlace-v3"),
}
STEPS = 50
"""Of an episode, at both: panda-gym steps at 25 Hz, karolos at 24."""


def measure(*, seconds: float = 10.0) -> list[Row]:
    """Steps per second of random episodes without their resets, in turn; medians.

    Raises:
        MachineError: panda-gym is not installed.
    """
    if find_spec("panda_gym") is None:
        raise MachineError(
            "panda-gym is not installed, so there is no peer to measure", hint="pip install --no-deps panda-gym"
        )
    import gymnasium  # noqa: PLC0415
    import panda_gym  # type: ignore[import-not-found]  # noqa: F401, PLC0415  (registers its environments)

    from ..environments import gymnasium_export  # noqa: F401, PLC0415

    rows = []
    for task, ids in TASKS.items():
        if ids[0] not in gymnasium.registry:
            continue
        environments: list[Any] = [gymnasium.make(name).unwrapped for name in ids]
        times: list[list[float]] = [[] for _ in environments]
        end, seed = perf_counter() + seconds / len(TASKS), 0
        while perf_counter() < end or seed < 2:
            for environment, found in zip(environments, times, strict=True):
                found.append(_episode(environment, seed))
            seed += 1
        for environment in environments:
            environment.close()
        ours, theirs = (1 / median(found) for found in times)
        rows.append(Row("environment", f"panda {task} cartesian", ours, "steps/s", PEER, theirs))
    return rows


def _episode(environment: Any, seed: int) -> float:
    """Seconds of processor time per step."""
    actions = np.random.Generator(np.random.PCG64(seed)).uniform(-1, 1, (STEPS, *environment.action_space.shape))
    environment.reset(seed=seed)
    started = thread_time()
    for action in actions.astype(np.float32):
        environment.step(action)
    return (thread_time() - started) / STEPS
