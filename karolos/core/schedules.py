"""When something is due, and how large it is, as objects instead of modulo arithmetic spread over loops."""

from __future__ import annotations

import math


class Every:
    """Due once for each multiple of `interval` that a growing count reaches or passes, the first one excluded at 0."""

    def __init__(self, interval: int) -> None:
        if interval < 1:
            raise ValueError(f"an interval is at least 1, not {interval}")
        self.interval = interval
        self.reached = 0

    def __call__(self, count: int) -> bool:
        """Whether a multiple was passed since the last call that said yes."""
        multiples = count // self.interval
        due = multiples > self.reached
        self.reached = max(self.reached, multiples)
        return due


class Ratio:
    """How many of one thing are due so that it keeps a fixed ratio to another; what is left over is carried on."""

    def __init__(self, ratio: float) -> None:
        if not 0 <= ratio < math.inf:
            raise ValueError(f"a ratio is finite and not negative, not {ratio}")
        self.ratio = ratio
        self.counted = 0

    def __call__(self, count: int) -> int:
        """What is due once `count` of the other thing have happened, less what was due before."""
        total = math.floor(count * self.ratio)
        due = max(total - self.counted, 0)
        self.counted = max(self.counted, total)
        return due


class Linear:
    """A number that goes evenly from `start` to `end` while a count grows from 0 to `over`, and stays at `end`."""

    def __init__(self, start: float, end: float, over: int) -> None:
        if over < 0:
            raise ValueError(f"a schedule goes over 0 counts or more, not {over}")
        self.start, self.end, self.over = start, end, over

    def __call__(self, count: int) -> float:
        if count >= self.over:
            return self.end
        return self.start + (self.end - self.start) * count / self.over
