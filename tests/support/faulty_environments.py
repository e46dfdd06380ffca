"""An environment of gymnasium with a fault, under the id support.faulty_environments:Faulty-v0."""

import os
import sys
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

SEEN = np.zeros(2, np.float32)
RESETS: dict[str, Any] = {
    "reset alone": SEEN,
    "reset shape": (np.zeros((1, 2), np.float32), {}),
    "reset text": (np.array(["a", "b"]), {}),
    "reset complex": (SEEN + 1j, {}),
    "reset bounds": (SEEN + 3, {}),
    "reset nan": (SEEN + np.nan, {}),
    "reset info": (SEEN, None),
}
STEPS: dict[str, Any] = {
    **{f"reward {value}": (SEEN, value, False, False, {}) for value in (None, np.nan, "1", 1j, "no")},
    "terminated": (SEEN, 0.0, None, False, {}),
    "truncated": (SEEN, 0.0, False, "no", {}),
    "step of four": (SEEN, 0.0, False, {}),
    "step shape": (SEEN[:1], 0.0, False, False, {}),
}
ENDS = {"_exit": os._exit, "exit": sys.exit}
FAULTS = [*RESETS, *STEPS, *(f"{end} in {place}" for end in ENDS for place in ("init", "reset", "step"))]


class Faulty(gymnasium.Env[Any, Any]):
    observation_space = Box(-1, 1, (2,), np.float32)
    action_space = Box(-1, 1, (1,), np.float32)

    def __init__(self, fault: str = "") -> None:
        self.fault = fault
        self._end("init")

    def _end(self, place: str) -> None:
        if self.fault.endswith(f" in {place}"):
            ENDS[self.fault.partition(" ")[0]](0)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        self._end("reset")
        return RESETS.get(self.fault, (SEEN, {}))

    def step(self, action: Any) -> Any:
        self._end("step")
        return STEPS.get(self.fault, (SEEN.astype(np.float64), np.float32(0), np.bool_(False), False, {}))


gymnasium.register("Faulty-v0", Faulty, max_episode_steps=10)
gymnasium.register("Limited-v0", lambda: gymnasium.wrappers.TimeLimit(Faulty(), 4), max_episode_steps=10)
