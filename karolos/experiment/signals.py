"""Stop requests: SIGINT, SIGTERM, SIGHUP, SIGUSR1, a time limit or the program. A second SIGINT stops at once."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

TIME_LIMIT_EXIT = 124
"""Exit code of an experiment that its time limit stopped; the same as that of timeout(1)."""


class StopRequestedError(Exception):
    """Breaks off what is going on, because a stop is requested."""


@dataclass
class StopRequest:
    """Whether a stop is requested. Training checks it after each round, tests and demonstrations at each step."""

    signal: int | None = None
    """The signal that requested it."""
    deadline: float | None = None
    """The time limit on the clock of `time.monotonic`; None: no limit."""
    program_reason: str | None = None
    """Why the program requests it, e.g. "pruned"; None: it does not."""

    @property
    def requested(self) -> bool:
        return self.signal is not None or self.program_reason is not None or self.time_is_up

    @property
    def time_is_up(self) -> bool:
        return self.deadline is not None and time.monotonic() >= self.deadline

    @property
    def reason(self) -> str | None:
        """A signal's name, the program's reason or "time limit"; None without a request."""
        if self.signal is not None:
            return signal.Signals(self.signal).name
        if self.program_reason is not None:
            return self.program_reason
        return "time limit" if self.time_is_up else None

    def check(self) -> None:
        """Raise a StopRequestedError if a stop is requested."""
        if self.requested:
            raise StopRequestedError

    @property
    def exit_code(self) -> int:
        """128 + signal as in a shell, e.g. 130 after SIGINT and 143 after SIGTERM; 124 after the time limit; else 0."""
        if self.signal is not None:
            return 128 + self.signal
        return TIME_LIMIT_EXIT if self.time_is_up else 0


@contextmanager
def stop_on_signals(*, interrupt: bool = True, time_limit: float | None = None) -> Iterator[StopRequest]:
    """Turn SIGINT, SIGTERM, SIGHUP and SIGUSR1 into a stop request while the block runs.

    Outside the main thread signals keep their handlers. An ignored SIGHUP stays ignored, for nohup.

    Args:
        interrupt: whether to handle SIGINT. A process whose parent handles it leaves it ignored.
        time_limit: seconds from now after which to stop.
    """
    request = StopRequest(deadline=None if time_limit is None else time.monotonic() + time_limit)
    if threading.current_thread() is not threading.main_thread():
        yield request
        return

    def handle(number: int, _frame: FrameType | None) -> None:
        if request.signal is None:
            request.signal = number
        elif number == signal.SIGINT:
            raise KeyboardInterrupt

    handled = [signal.SIGTERM]
    if interrupt:
        handled.append(signal.SIGINT)
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # Windows does not have it
        handled.append(signal.SIGHUP)
    if hasattr(signal, "SIGUSR1"):  # batch systems send it some time before they kill
        handled.append(signal.SIGUSR1)
    before = {number: signal.signal(number, handle) for number in handled}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
