"""What a test of an agent found. Apart from `testing`, so that who only reads results need not load what plays them."""

from __future__ import annotations

from dataclasses import dataclass

WITHIN = (0.05, 0.1, 0.25)
"""Distances in m for which reports say how many test episodes ended nearer to their goal, whatever the threshold."""


@dataclass(frozen=True)
class TestResult:
    """What one test found. The lists hold one entry per test seed, in the order of the seeds.

    `any`: the goal was reached at some step; `end`: it held at the last; `reset`: it held before the first action.
    """

    __test__ = False  # not a test case, whatever its name says to pytest

    steps: int
    """Environment steps of training before the test."""
    seconds: float
    """Wall-clock seconds of collecting and learning before the test; tests excluded."""
    any: tuple[bool, ...]
    end: tuple[bool, ...]
    reset: tuple[bool, ...]
    returns: tuple[float, ...]
    lengths: tuple[int, ...]
    distances: tuple[float, ...] | None = None
    """From the goal at the last step, in m; inf where it does not count (nothing landed). None: none is known."""

    @property
    def episodes(self) -> int:
        return len(self.any)

    @property
    def success_any(self) -> float:
        """Share of episodes in which the goal was reached at some step."""
        return sum(self.any) / self.episodes

    @property
    def success_end(self) -> float:
        """Share of episodes in which the goal held at the last step."""
        return sum(self.end) / self.episodes

    def within(self, metres: float) -> float | None:
        """Share of episodes that ended nearer than this to their goal; None where no distance is known."""
        return None if self.distances is None else sum(far < metres for far in self.distances) / self.episodes
