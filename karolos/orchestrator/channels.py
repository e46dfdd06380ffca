"""A worker process in the parent: its channels, their pending commands, and how the process ended."""

from __future__ import annotations

import signal
import sys
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from time import monotonic

import numpy as np

from ..errors import WorkerError
from .backend import Group, Ids
from .shared_memory import EnvironmentArrays
from .start import WorkerProcess, start_worker

if sys.platform != "win32":
    from select import POLLIN, poll


class Channel:
    """The connection to one thread of a worker. It is ready once the environments are built and share memory."""

    def __init__(self, worker: Worker, connection: Connection, ids: range) -> None:
        self.worker = worker
        self.connection = connection
        self.ids = ids
        self.ready = False
        self.pending: deque[Group] = deque()
        """The groups of the commands without an answer, oldest first."""
        self._backlog: list[bytes] = []
        self._sent = 0
        self._progress = (-1, -1)
        self._since = monotonic()

    @property
    def busy(self) -> bool:
        """Whether an answer is missing: to a command, or the first one after building."""
        return bool(self.pending) or not self.ready

    def send(self, message: bytes, group: Group) -> None:
        """Send a command for a group, or queue it until the channel is ready. Ignores a closed connection."""
        self.pending.append(group)
        self._sent += 1
        self._backlog.append(message)
        if self.ready:
            self.open()

    def open(self) -> None:
        """Mark the channel as ready and send the queued commands."""
        self.ready = True
        with suppress(OSError):
            for message in self._backlog:
                self.connection.send_bytes(message)
        self._backlog.clear()

    def receive(self) -> bytes | None:
        """The next message; None if the connection has ended."""
        try:
            return self.connection.recv_bytes()
        except (EOFError, OSError):
            return None

    def stalled_seconds(self, arrays: EnvironmentArrays | None, now: float) -> float:
        """Seconds without a completed command; 0 for an idle channel."""
        completed = int(arrays.commands[self.ids.start : self.ids.stop].sum()) if arrays and self.ready else 0
        progress = (self._sent, completed)
        if progress != self._progress or not self.busy:
            self._progress, self._since = progress, now
        return now - self._since


class Worker:
    """Worker process `number`. Raises OSError or EOFError when the machine gives no process."""

    def __init__(self, number: int, recipe: bytes, ids: Sequence[range], size: int) -> None:
        self.number = number
        self.process: WorkerProcess
        self.process, connections = start_worker(number, recipe, ids, size)
        self.channels = [Channel(self, *channel) for channel in zip(connections, ids, strict=True)]
        self.lost: WorkerError | None = None
        """How the process ended; None while it runs."""

    @property
    def environments(self) -> Ids:
        return np.arange(self.channels[0].ids.start, self.channels[-1].ids.stop)

    def close_connections(self) -> None:
        """Close the connections, which makes the process exit."""
        for channel in self.channels:
            channel.connection.close()

    def end(self) -> WorkerError:
        """Make sure that the process has ended; returns an error that says how."""
        self.process.join(1.0)  # the connection closes shortly before the exit code is available
        cause, hint = _cause_of_exit(self.process.exitcode)
        self.join(monotonic())
        return self.error(cause, hint)

    def join(self, deadline: float) -> None:
        """Wait for the process until `deadline` (monotonic, s), then kill it, and release its handle."""
        self.process.join(max(0.0, deadline - monotonic()))
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.process.close()  # releases a file descriptor

    def error(self, what: str, hint: str) -> WorkerError:
        return worker_error(what, hint, self.process.name, self.environments)


def worker_error(what: str, hint: str, name: str, ids: Ids) -> WorkerError:
    """A WorkerError that names the worker and its environments."""
    named = f"environments {ids[0]} to {ids[-1]}" if ids.size > 1 else f"environment {ids[0]}"
    return WorkerError(f"{what}, with {named}", where=name, hint=hint)


def _cause_of_exit(code: int | None) -> tuple[str, str]:
    if code is None:
        return "a thread of the worker ended", "see standard error for the cause"
    if code >= 0:
        return f"the worker process ended with exit code {code}", "the environment or a plugin ended it"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
    if name == "SIGKILL":
        return f"the worker process was killed by {name}", "probably out of memory: use fewer environments"
    return f"the worker process was killed by {name}", "standard error shows the line in native code"


class Poller:
    """Waits for channels with a message or an ended connection. Registering a channel once makes polling cheap."""

    def __init__(self) -> None:
        self._channels: dict[int, Channel] = {}
        if sys.platform != "win32":
            self._poll = poll()

    def add(self, channel: Channel) -> None:
        self._channels[channel.connection.fileno()] = channel
        if sys.platform != "win32":
            self._poll.register(channel.connection, POLLIN)

    def remove(self, channel: Channel) -> None:
        """Unregister a channel. Call this before its connection is closed."""
        del self._channels[channel.connection.fileno()]
        if sys.platform != "win32":
            self._poll.unregister(channel.connection)

    def poll(self, timeout: float) -> list[Channel]:
        """The channels that can be read; waits up to `timeout` seconds for one."""
        if sys.platform != "win32":
            return [self._channels[number] for number, _ in self._poll.poll(1e3 * timeout)]
        readable = set(wait([channel.connection for channel in self._channels.values()], timeout))
        return [channel for channel in self._channels.values() if channel.connection in readable]
