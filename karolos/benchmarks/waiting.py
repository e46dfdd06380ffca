"""An environment that does nothing but wait, as one does that asks a device or another program."""

from __future__ import annotations

from time import sleep

import numpy as np

from ..core import Array, Environment, Field, Layout, Signature, Step


class Waiting(Environment):
    """Each reset and step takes `seconds`, in which Python's interpreter lock is free."""

    def __init__(self, seconds: float) -> None:
        self.signature = Signature(Layout((Field("nothing", 1),)), Layout((Field("nothing", 1),)), max_steps=100)
        self._seconds = seconds
        self._steps = 0

    def reset(self, seed: int) -> Step:  # noqa: ARG002 (every episode is the same)
        self._steps = 0
        return self._waited()

    def step(self, action: Array) -> Step:  # noqa: ARG002 (part of the interface)
        self._steps += 1
        return self._waited()

    def _waited(self) -> Step:
        sleep(self._seconds)
        nothing = np.zeros(0, np.float32)
        return Step(np.zeros(1, np.float32), nothing, nothing, 0.0, False, self._steps == 100, False)
