"""One worker process as its parent sees it: its lanes, what is under way in them, how it ended."""

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
from .block import Block
from .crew import Group, Ids
from .start import WorkerProcess, start_worker

if sys.platform != "win32":
    from select import POLLIN, poll


class Lane:
    """One thread of a worker process. It is ready when its environments are built and it has the shared memory."""

    def __init__(self, worker: Worker, connection: Connection, ids: range) -> None:
        self.worker = worker
        self.connection = connection
        self.ids = ids
        self.ready = False
        self._under_way: deque[Group] = deque()
        self._backlog: list[bytes] = []
        self._sent = 0
        self._seen = (-1, -1)
        self._since = monotonic()

    @property
    def busy(self) -> bool:
        """Whether something is asked of it and not answered: its first answer, or a command's."""
        return bool(self._under_way) or not self.ready

    def send(self, message: bytes, group: Group) -> None:
        """Ask for a command on a group; kept until the lane is ready. Raises nothing: its end is heard, not felt."""
        self._under_way.append(group)
        self._sent += 1
        if self.ready:
            with suppress(OSError):
                self.connection.send_bytes(message)
        else:
            self._backlog.append(message)

    def open(self) -> None:
        """The lane is ready: send what has waited for that."""
        self.ready = True
        with suppress(OSError):
            for message in self._backlog:
                self.connection.send_bytes(message)
        self._backlog.clear()

    def receive(self) -> bytes | None:
        """The next message; None when there will be none."""
        try:
            return self.connection.recv_bytes()
        except (EOFError, OSError):
            return None

    def answered(self) -> Group:
        """The environments that the message just received speaks for."""
        return self._under_way.popleft()

    def still_for(self, block: Block | None, now: float) -> float:
        """Seconds for which nothing was seen to end in it; 0 for a lane that is asked for nothing."""
        done = int(block.commands[self.ids.start : self.ids.stop].sum()) if block and self.ready else 0
        seen = (self._sent, done)
        if seen != self._seen or not self.busy:
            self._seen, self._since = seen, now
        return now - self._since


class Worker:
    """Worker process `number`. Raises OSError or EOFError when the machine gives no process."""

    def __init__(self, number: int, recipe: bytes, ids: Sequence[range], size: int) -> None:
        self.number = number
        self.process: WorkerProcess
        self.process, connections = start_worker(number, recipe, ids, size)
        self.lanes = [Lane(self, *lane) for lane in zip(connections, ids, strict=True)]
        self.lost: WorkerError | None = None
        """Why it is no more."""

    @property
    def environments(self) -> Ids:
        return np.concatenate([np.arange(lane.ids.start, lane.ids.stop) for lane in self.lanes])

    def hang_up(self) -> None:
        """Close its connections, which tells it to end."""
        for lane in self.lanes:
            lane.connection.close()

    def end(self) -> WorkerError:
        """The process is gone or wanted no more: see to it that it is. The error says how it ended."""
        self.process.join(1.0)  # its connection closes a moment before its exit code can be read
        how, hint = _how_it_ended(self.process.exitcode)
        self.free(monotonic())
        return self.error(how, hint)

    def free(self, deadline: float) -> None:
        """Wait for the process until `deadline` (monotonic, s), kill it if that does not help, and forget it."""
        self.process.join(max(0.0, deadline - monotonic()))
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.process.close()  # its handle is a file descriptor

    def error(self, what: str, hint: str) -> WorkerError:
        """An error that names the worker and its environments."""
        ids = self.environments
        named = f"environments {ids[0]} to {ids[-1]}" if ids.size > 1 else f"environment {ids[0]}"
        return WorkerError(f"{what}, with {named}", where=self.process.name, hint=hint)


def _how_it_ended(code: int | None) -> tuple[str, str]:
    if code is None:
        return "a thread of the worker ended", "standard error shows why"
    if code >= 0:
        return f"the worker process ended with exit code {code}", "the environment or a plugin has ended it"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
    if name == "SIGKILL":
        return f"the worker process was killed by {name}", "if nobody did, memory ran out: use fewer environments"
    return f"the worker process was killed by {name}", "standard error shows where native code crashed"


class Doorbells:
    """Says which lanes have sent something, or ended. Lanes are added once, which is what makes asking cheap."""

    def __init__(self) -> None:
        self._lanes: dict[int, Lane] = {}
        if sys.platform != "win32":
            self._poll = poll()

    def add(self, lane: Lane) -> None:
        self._lanes[lane.connection.fileno()] = lane
        if sys.platform != "win32":
            self._poll.register(lane.connection, POLLIN)

    def remove(self, lane: Lane) -> None:
        """To be called before the lane's connection is closed."""
        del self._lanes[lane.connection.fileno()]
        if sys.platform != "win32":
            self._poll.unregister(lane.connection)

    def rung(self, timeout: float) -> list[Lane]:
        """The lanes that can be heard; waits for one, at most `timeout` seconds."""
        if sys.platform != "win32":
            return [self._lanes[number] for number, _ in self._poll.poll(1e3 * timeout)]
        heard = set(wait([lane.connection for lane in self._lanes.values()], timeout))
        return [lane for lane in self._lanes.values() if lane.connection in heard]
