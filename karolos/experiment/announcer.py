"""Tells the listener of a run how far it is."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from ..training.training import Progress
from .events import Listener, RunAdvanced, RunBusy

ADVANCE_SECONDS = 0.1
"""Minimal time between two RunAdvanced or two RunBusy events."""
SPEED_WINDOW = 100
"""RunAdvanced events from which the time left is estimated: about ten seconds."""

Announce = Callable[[str, int, int], None]
"""Is called with an activity, and how much of it is done, of how much."""


@dataclass
class Announcer:
    """Tells the listener how far training and tests are, and how long they will take."""

    run: str
    steps: int
    """Environment steps of the run."""
    listener: Listener
    seconds_left: Callable[[float, int], float] = field(default=lambda seconds, _: seconds, init=False)
    """Seconds to the end of training and tests, given the seconds and steps of training left."""
    _advanced: float = field(default=0.0, init=False)
    """Time of the last RunAdvanced event."""
    _busy: float = field(default=0.0, init=False)
    """Time of the last RunBusy event."""
    _trained: bool = field(default=False, init=False)
    """Whether training is complete."""
    _points: deque[tuple[float, int]] = field(default_factory=lambda: deque(maxlen=SPEED_WINDOW), init=False)
    """Seconds and steps of training at the latest events."""

    def announce(self, activity: str, done: int, total: int) -> None:
        """Tell how far a test or another activity is."""
        now = time.monotonic()
        if done in (0, total) or now - self._busy >= ADVANCE_SECONDS:
            self._busy = now
            left = self.seconds_left(0.0, 0) if self._trained else None
            self.listener(RunBusy(self.run, activity, done, total, left))

    def progressed(self, progress: Progress) -> None:
        """A round of training is over."""
        self._trained = progress.steps >= self.steps
        now = time.monotonic()
        if now - self._advanced >= ADVANCE_SECONDS:
            self._advanced = now
            counts = progress.steps, progress.updates, progress.episodes
            left = self._estimate_seconds_left(progress)
            self.listener(RunAdvanced(self.run, *counts, progress.seconds, progress.warming_up, left))

    def _estimate_seconds_left(self, progress: Progress) -> float | None:
        if progress.warming_up:  # the rounds that learn take longer
            return None
        self._points.append((progress.seconds, progress.steps))
        (start, steps), (end, more_steps) = self._points[0], self._points[-1]
        if more_steps == steps:
            return None
        left = self.steps - progress.steps
        return self.seconds_left((end - start) / (more_steps - steps) * left, left)
