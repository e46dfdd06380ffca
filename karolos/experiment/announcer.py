"""Tells the listener of a run how far it is."""

from __future__ import annotations

import time
from collections.abc import Callable

from ..training.training import Progress
from .events import Listener, RunAdvanced, RunBusy

ADVANCE_SECONDS = 0.1
"""Minimal time between two RunAdvanced or two RunBusy events."""

Announce = Callable[[str, int, int], None]
"""Is called with an activity, and how much of it is done, of how much."""


class Announcer:
    """Tells the listener how far training and tests are.

    Args:
        run: its id.
        listener: is called with RunAdvanced and RunBusy.
    """

    def __init__(self, run: str, listener: Listener) -> None:
        self.run, self.listener = run, listener
        self._advanced = self._busy = 0.0
        """Times of the last RunAdvanced and RunBusy event."""

    def announce(self, activity: str, done: int, total: int) -> None:
        """Tell how far a test or another activity is."""
        now = time.monotonic()
        if done in (0, total) or now - self._busy >= ADVANCE_SECONDS:
            self._busy = now
            self.listener(RunBusy(self.run, activity, done, total))

    def progressed(self, progress: Progress) -> None:
        """A round of training is over."""
        now = time.monotonic()
        if now - self._advanced >= ADVANCE_SECONDS:
            self._advanced = now
            counts = progress.steps, progress.updates, progress.episodes
            self.listener(RunAdvanced(self.run, *counts, progress.seconds, progress.warming_up))
