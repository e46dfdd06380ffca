"""An environment whose steps only wait, as for a device or another program. Workers import it without torch."""

from __future__ import annotations

from time import sleep

import numpy as np

from ..core import Array, Environment, Field, Layout, Signature, Step


class Waiting(Environment):
    """Each reset and step sleeps `seconds`, which frees Python's interpreter lock."""

    def __init__(self, seconds: float) -> None:
        self.signature = Signature(Layout((Field("zero", 1),)), Layout((Field("unused", 1),)), max_steps=100)
        self._seconds = seconds
        self._steps = 0

    def reset(self, seed: int) -> Step:  # noqa: ARG002 (every episode is the same)
        self._steps = 0
        return self._sleep()

    def step(self, action: Array) -> Step:  # noqa: ARG002 (part of the interface)
        self._steps += 1
        return self._sleep()

    def _sleep(self) -> Step:
        sleep(self._seconds)
        no_goal = np.zeros(0, np.float32)
        return Step(np.zeros(1, np.float32), no_goal, no_goal, 0.0, False, self._steps == 100, False)
