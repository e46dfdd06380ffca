"""Tells the listener of a run how far it is."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from ..training.training import Progress
from .events import Listener, RunAdvanced, RunBusy

ADVANCE_SECONDS = 0.1
"""Minimal time between two RunAdvanced or two RunBusy events."""
SPEED_WINDOW = 100
"""RunAdvanced events from which the time left is estimated: about ten seconds."""

Announce = Callable[[str, int, int], None]
"""Is called with an activity, and how much of it is done, of how much."""


class Announcer:
    """Tells the listener how far training and tests are, and how long they will take.

    Args:
        run: its id.
        steps: environment steps of the run.
        listener: is called with RunAdvanced and RunBusy.
    """

    def __init__(self, run: str, steps: int, listener: Listener) -> None:
        self.run, self.steps, self.listener = run, steps, listener
        self.seconds_left: Callable[[float, int], float] = lambda seconds, _: seconds
        """Seconds to the end of training and tests, given the seconds and steps of training left."""
        self._advanced = self._busy = 0.0
        """Times of the last RunAdvanced and RunBusy event."""
        self._trained = False
        self._points: deque[tuple[float, int]] = deque(maxlen=SPEED_WINDOW)
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
