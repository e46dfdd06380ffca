"""A gymnasium environment that misbehaves in the method, and in the way, that its argument says, e.g. "step:exit".

"late step:exit" does so after some calls, and not yet when a spec is checked; "tail step:nan" late in each episode.
"""

import os
import signal
import sys
import time
from collections import Counter
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete

METHODS = ("init", "reset", "step", "close")
KINDS = ("raise", "exit", "interrupt", "quirky", "hang", "die", "print", "nan", "none", "text", "shape", "leak", "deep")
"""nan to shape: what `reset` and `step` observe."""
STEPS = 10
LATE = {"init": 4, "reset": 4, "step": 30, "close": 4}
CALLS: Counter[str] = Counter()
"""How often each method was called, in environments that were built again, too."""


class QuirkyError(Exception):
    """Has no text, and no pickle."""

    def __init__(self) -> None:
        self.callback = lambda: None

    def __str__(self) -> str:
        raise RuntimeError("it has no text either")


class Hostile(gymnasium.Env[Any, Any]):
    """Two numbers, which grow; the reward is their sum."""

    def __init__(self, trouble: str = "") -> None:
        self._method, _, self._kind = trouble.partition(":")
        self.observation_space = Box(-np.inf, np.inf, (2,), np.float32)
        self.action_space: Any = Discrete(10**9) if trouble == "discrete" else Box(-1, 1, (1,), np.float32)
        self._leaked: list[bytearray] = []
        self._seen("init")

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        self._steps = 0
        return self._seen("reset"), {}

    def step(self, action: Any) -> Any:
        self._steps += 1
        return self._seen("step"), 0.1, False, self._steps >= STEPS, {}

    def close(self) -> None:
        self._seen("close")

    def _seen(self, method: str) -> Any:
        """Make the trouble of a method, or give an observation."""
        CALLS[method] += 1
        late = self._method == f"late {method}" and CALLS[method] > LATE[method]
        late = late or (self._method == f"tail {method}" and self._steps > STEPS // 2)
        kind = self._kind if late or method == self._method else ""
        if kind == "raise":
            raise ZeroDivisionError("the inertia is zero\nand a second line")
        if kind == "exit":
            sys.exit(0)
        if kind == "interrupt":
            raise KeyboardInterrupt
        if kind == "quirky":
            raise QuirkyError
        if kind == "hang":
            time.sleep(600)
        if kind == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if kind == "print":
            print("noise", flush=True)
        if kind == "leak":
            self._leaked.append(bytearray(2**24))
        if kind == "deep":
            return self._seen(method)
        wrong = {"nan": np.full(2, np.nan, np.float32), "none": None, "text": "much", "shape": np.zeros(3, np.float32)}
        return wrong.get(kind, np.full(2, 0.1, np.float32))


gymnasium.register("Hostile-v0", entry_point=Hostile, max_episode_steps=STEPS)


def spec(trouble: str, processes: int = 0) -> dict[str, Any]:
    """An experiment in it that takes a fraction of a second."""
    CALLS.clear()
    return {
        "name": "hostile",
        "environment": {"name": "gymnasium", "id": f"{__name__}:Hostile-v0", "kwargs": {"trouble": trouble}},
        "agent": {"name": "sac", "hidden": [8]},
        "orchestrator": {"processes": processes, "environments": 2, "time_limit": 2.0},
        "training": {"steps": 80, "batch_size": 8, "replay_ratio": 1, "warmup_episodes": 2},
        "testing": {"interval": 40, "episodes": 2},
    }
