"""Stop requests: a signal, a time limit, the file `stop` of a run, or the end of the process that follows the run.

The signals are SIGINT, SIGTERM, SIGHUP and SIGUSR1. A second SIGINT stops at once.
"""

from __future__ import annotations

import signal
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

from .. import system
from ..core import Orchestrator

TIME_LIMIT_EXIT = 124
"""Exit code of an experiment that its time limit stopped; the same as that of timeout(1)."""
LOOK_SECONDS = 0.2
"""Time between two checks for a request, e.g. the file `stop`."""
GRACE_SECONDS = 0.6
"""Time after a request in which environments must answer. Then the round is aborted."""
HANG_SECONDS = 60.0
"""Time after the time limit when anything else is aborted, e.g. an environment whose `close` hangs."""


class StopRequestedError(BaseException):
    """Aborts the current work because a stop is requested. `except Exception` does not catch it."""


@dataclass
class StopRequest:
    """Whether a stop is requested. Training checks it after each round, tests and demonstrations at each step."""

    signal: int | None = None
    """The signal that requested it."""
    deadline: float | None = None
    """The time limit on the clock of `time.monotonic`; None: no limit."""
    file: Path | None = None
    """A file that requests it and holds the reason, e.g. "pruned"; None: there is no such file."""
    driver: int | None = None
    """A file descriptor of a pipe, which ends with the process that this one follows."""
    _reason: str | None = field(default=None, init=False)
    """The content of the file."""
    _looked: float = field(default=0.0, init=False)
    _since: float | None = field(default=None, init=False)
    """When the request was noticed."""
    _calm_until: float = field(default=0.0, init=False)
    """Nothing is aborted before this time, so that aborted work can clean up."""
    handles_signals: bool = field(default=False, init=False)
    """Whether signals reach it; they do only in the main thread."""
    breaks: bool = field(default=False, init=False)
    """Whether a request aborts the current work."""

    def watch(self, file: Path) -> None:
        """Check this file of a starting run from now on. A request by an earlier file no longer counts."""
        system.remove(file, missing_ok=True)  # of an earlier process
        self.file, self._reason, self._since, self._calm_until = file, None, None, 0.0

    @property
    def requested(self) -> bool:
        if self.file is not None and time.monotonic() - self._looked >= LOOK_SECONDS:
            self._look(self.file)
        return self.signal is not None or self._reason is not None or self.time_is_up

    def _look(self, file: Path) -> None:
        self._looked = time.monotonic()
        with suppress(FileNotFoundError):
            self._reason = file.read_text("utf-8")
        if self.driver is not None and system.has_ended(self.driver):
            self.signal = signal.SIGTERM

    @property
    def time_is_up(self) -> bool:
        return self.deadline is not None and time.monotonic() >= self.deadline

    @property
    def reason(self) -> str | None:
        """The file's reason, a signal's name or "time limit"; None without a request."""
        if self._reason is not None:
            return self._reason
        if self.signal is not None:
            return signal.Signals(self.signal).name
        return "time limit" if self.time_is_up else None

    def check(self) -> None:
        """Raise a StopRequestedError if a stop is requested."""
        if self.requested:
            raise StopRequestedError

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Let a request abort the block at any point: for work that loses nothing and may take long, e.g. building.

        Raises a StopRequestedError. A block within another one changes nothing.
        """
        self.check()
        if self.breaks or not self.handles_signals:
            yield
            return
        self.breaks = True
        try:
            yield
        finally:
            self.breaks = False

    def look(self, frame: FrameType | None) -> None:
        """Abort the work in this frame, if a stop is requested and the work may be aborted or takes too long."""
        now = time.monotonic()
        if not self.requested or now < self._calm_until or not _can_break(frame):
            return
        self._since = now if self._since is None else self._since
        waited = now - self._since
        hangs = waited >= HANG_SECONDS and self.time_is_up  # after a signal a person can send another one
        if self.breaks or hangs or (waited >= GRACE_SECONDS and _is_receiving(frame)):
            self.breaks, self._calm_until = False, now + HANG_SECONDS
            raise StopRequestedError

    @property
    def exit_code(self) -> int:
        """128 + signal as in a shell, e.g. 130 after SIGINT and 143 after SIGTERM; 124 after the time limit; else 0."""
        if self.signal is not None:
            return 128 + self.signal
        return TIME_LIMIT_EXIT if self.time_is_up else 0


def _can_break(frame: FrameType | None) -> bool:
    """Whether an error can be raised in a frame: an import cannot be repeated, and native code drops errors."""
    code = [one.f_code for one, _ in traceback.walk_stack(frame)]
    files = " ".join(one.co_filename for one in code)
    return not ("<frozen importlib" in files or "llvmlite" in files or "__del__" in [one.co_name for one in code])


def _is_receiving(frame: FrameType | None) -> bool:
    """Whether a frame waits for the answers of environments: one of them may hang."""
    return any(
        one.f_code.co_name == "receive" and isinstance(one.f_locals.get("self"), Orchestrator)
        for one, _ in traceback.walk_stack(frame)
    )


@contextmanager
def stop_on_signals(
    *, time_limit: float | None = None, file: Path | None = None, driver: int | None = None
) -> Iterator[StopRequest]:
    """Turn SIGINT, SIGTERM, SIGHUP and SIGUSR1 into a stop request while the block runs.

    Outside the main thread signals keep their handlers. SIGINT and SIGHUP stay ignored where they are, as under nohup
    and in a shell's background.

    `time_limit` is in seconds from now; `file` and `driver` as in StopRequest.
    """
    request = StopRequest(None, None if time_limit is None else time.monotonic() + time_limit, file, driver)
    if threading.current_thread() is not threading.main_thread():
        yield request
        return

    def handle(number: int, frame: FrameType | None) -> None:
        if request.signal is None:
            request.signal = number
        elif number == signal.SIGINT:
            raise KeyboardInterrupt
        request.look(frame)

    kept = [one for one in system.STOP_SIGNALS if signal.getsignal(one) != signal.SIG_IGN]
    before = {number: signal.signal(number, handle) for number in kept}
    before[system.ALARM] = system.on_alarm(lambda _, frame: request.look(frame))
    request.handles_signals = True
    system.set_alarm(LOOK_SECONDS)
    try:
        yield request
    finally:
        request.handles_signals = False
        system.set_alarm(0.0)
        for number, handler in before.items():
            signal.signal(number, handler)
