"""Schedules: when something is due, and the value of a quantity, as functions of a count."""

from __future__ import annotations

import math


class Every:
    """Due whenever a growing count reaches or passes a positive multiple of `interval`."""

    def __init__(self, interval: int) -> None:
        self.interval = interval
        self.reached = 0

    def __call__(self, count: int) -> bool:
        """Whether a multiple has been reached since the last call that returned True."""
        multiples = count // self.interval
        due = multiples > self.reached
        self.reached = max(self.reached, multiples)
        return due


class Ratio:
    """The number of events due, so that they keep a fixed ratio to another count; fractions carry over."""

    def __init__(self, ratio: float) -> None:
        self.ratio = ratio
        self.counted = 0

    def __call__(self, count: int) -> int:
        """The number due at this count, minus the number that earlier calls returned."""
        total = math.floor(count * self.ratio)
        due = max(total - self.counted, 0)
        self.counted = max(self.counted, total)
        return due


class Linear:
    """Linear interpolation from `start` at count 0 to `end` at count `over`, constant afterwards."""

    def __init__(self, start: float, end: float, over: int) -> None:
        self.start, self.end, self.over = start, end, over

    def __call__(self, count: int) -> float:
        if count >= self.over:
            return self.end
        return self.start + (self.end - self.start) * count / self.over
