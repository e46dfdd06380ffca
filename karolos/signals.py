"""Stopping on request: the first SIGINT or SIGTERM asks, the second SIGINT ends at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType


@dataclass
class StopRequest:
    """Which signal asked to stop, if any. Looked at between rounds of training."""

    signal: int | None = None

    @property
    def exit_code(self) -> int:
        """130 after SIGINT, 143 after SIGTERM, by the shell's convention 128 + signal."""
        return 128 + (self.signal or 0)


@contextmanager
def stop_on_signals(*, interrupt: bool = True) -> Iterator[StopRequest]:
    """Turn SIGINT and SIGTERM into a request while the block runs; outside the main thread they stay as they are.

    Args:
        interrupt: whether SIGINT is ours to take; a process whose parent decides leaves it ignored.
    """
    request = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return

    def ask(number: int, _frame: FrameType | None) -> None:
        if request.signal is None:
            request.signal = number
        elif number == signal.SIGINT:
            raise KeyboardInterrupt

    taken = (signal.SIGINT, signal.SIGTERM) if interrupt else (signal.SIGTERM,)
    before = {number: signal.signal(number, ask) for number in taken}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
