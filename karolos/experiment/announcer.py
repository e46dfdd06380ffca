"""Tells the listener of a run how far it is, and has it written down."""

from __future__ import annotations

import time
from collections.abc import Callable

from ..training.training import Progress
from .events import Listener, RunAdvanced, RunBusy

ADVANCE_SECONDS = 0.1
"""Minimal time between two RunAdvanced or two RunBusy events."""

WRITE_SECONDS = 4.0
"""Time after which the progress is written down again, so that whoever looks sees it every five seconds."""

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
        self.write: Callable[[], object] = lambda: None
        """Is called every WRITE_SECONDS to write down how far the run is."""
        self._advanced = self._busy = 0.0
        """Times of the last RunAdvanced and RunBusy event."""
        self._written = time.monotonic()

    def announce(self, activity: str, done: int, total: int) -> None:
        """Tell how far a test or another activity is."""
        now = time.monotonic()
        if done in (0, total) or now - self._busy >= ADVANCE_SECONDS:
            self._busy = now
            self.listener(RunBusy(self.run, activity, done, total))
            self._write(now)

    def progressed(self, progress: Progress, *, last: bool) -> None:
        """A round of training is over; `last`: and training is."""
        now = time.monotonic()
        if last or now - self._advanced >= ADVANCE_SECONDS:
            self._advanced = now
            counts = progress.steps, progress.updates, progress.episodes
            self.listener(RunAdvanced(self.run, *counts, progress.seconds, progress.warming_up))
            self._write(now)

    def _write(self, now: float) -> None:
        if now - self._written >= WRITE_SECONDS:
            self._written = now
            self.write()
