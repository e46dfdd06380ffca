"""Stopping on request: SIGINT, SIGTERM, SIGUSR1, a time limit or the program asks, a second SIGINT ends at once."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

TIME_LIMIT_EXIT = 124
"""Exit code of an experiment that its time limit stopped; that of timeout(1)."""


@dataclass
class StopRequest:
    """Whether somebody asked to stop. Looked at between rounds of training."""

    signal: int | None = None
    """The signal that asked, if one did."""
    deadline: float | None = None
    """When the time limit is reached, as `time.monotonic` counts; None: there is no limit."""
    word: str | None = None
    """Why the program itself asks, e.g. "pruned"; None: it does not."""

    @property
    def asked(self) -> bool:
        return self.signal is not None or self.word is not None or self.late

    @property
    def late(self) -> bool:
        """Whether the time limit is reached."""
        return self.deadline is not None and time.monotonic() >= self.deadline

    @property
    def reason(self) -> str | None:
        """Who asked: a signal's name, the program's word, or the time limit; None if nobody did."""
        if self.signal is not None:
            return signal.Signals(self.signal).name
        if self.word is not None:
            return self.word
        return "time limit" if self.late else None

    @property
    def exit_code(self) -> int:
        """130 after SIGINT, 143 after SIGTERM, by the shell's convention 128 + signal; 124 after the time limit."""
        if self.signal is not None:
            return 128 + self.signal
        return TIME_LIMIT_EXIT if self.late else 0


@contextmanager
def stop_on_signals(*, interrupt: bool = True, time_limit: float | None = None) -> Iterator[StopRequest]:
    """Turn SIGINT, SIGTERM and SIGUSR1 into a request while the block runs.

    Outside the main thread signals stay as they are.

    Args:
        interrupt: whether SIGINT is ours to take; a process whose parent decides leaves it ignored.
        time_limit: seconds from now after which to stop.
    """
    request = StopRequest(deadline=None if time_limit is None else time.monotonic() + time_limit)
    if threading.current_thread() is not threading.main_thread():
        yield request
        return

    def ask(number: int, _frame: FrameType | None) -> None:
        if request.signal is None:
            request.signal = number
        elif number == signal.SIGINT:
            raise KeyboardInterrupt

    taken = [signal.SIGTERM]
    if interrupt:
        taken.append(signal.SIGINT)
    if hasattr(signal, "SIGUSR1"):  # what batch systems send some time before they kill; Windows has none
        taken.append(signal.SIGUSR1)
    before = {number: signal.signal(number, ask) for number in taken}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
