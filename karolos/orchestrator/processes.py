"""Workers that are processes of this machine and share memory with this one."""

from __future__ import annotations

from collections.abc import Sequence

from typing_extensions import override

from ..core import BuildEnvironment, Signature
from ..errors import MachineError
from ..system import Poller, SharedMemory, ended_by
from .pool import Channel, EnvironmentWorker, WorkerPool
from .shared_memory import EnvironmentArrays
from .start import pack_build, start_worker


class ProcessPool(WorkerPool):
    """Runs environments in worker processes, with a thread for each channel."""

    def __init__(
        self, build: BuildEnvironment, layout: Sequence[Sequence[range]], time_limit: float, failures: int
    ) -> None:
        self._build = pack_build(build)
        self._poller: Poller[Channel] = Poller()
        self._memory: SharedMemory | None = None
        super().__init__(layout, time_limit, failures)

    @override
    def _start(self, number: int) -> EnvironmentWorker:
        try:
            return ProcessWorker(number, self._build, self._layout[number], self._size, self._poller)
        except (OSError, EOFError) as error:
            raise MachineError(
                f"worker process {number} of {len(self._layout)} cannot be started: {error}",
                setting="orchestrator",
                hint="use fewer processes, or `processes: 0` to step environments in the main process",
            ) from error

    @override
    def _allocate(self, signature: Signature) -> EnvironmentArrays:
        self._memory = SharedMemory(EnvironmentArrays.size(signature, self._size))
        return EnvironmentArrays.over(self._memory.buffer, signature, self._size)

    @override
    def _share(self, channel: Channel) -> None:
        assert self._memory is not None
        self._memory.send(channel.connection)

    @override
    def _readable(self, timeout: float) -> list[Channel]:
        return self._poller.ready(timeout)

    @override
    def close(self) -> None:
        super().close()
        if self._memory is not None:
            self.arrays = EnvironmentArrays.private(self.signature, 0)  # a traceback may refer to the old arrays
            self._memory.close()


class ProcessWorker(EnvironmentWorker):
    """A worker process. Raises OSError or EOFError when the machine gives no process."""

    def __init__(
        self, number: int, packed_build: bytes, ids: Sequence[range], size: int, poller: Poller[Channel]
    ) -> None:
        self.process, connections = start_worker(number, packed_build, ids, size)
        super().__init__(number, connections, ids)
        self._poller = poller
        for channel in self.channels:
            poller.add(channel.connection, channel)

    @override
    def close_connections(self) -> None:
        for channel in self.channels:
            self._poller.remove(channel.connection)
        super().close_connections()

    @override
    def end(self, seconds: float) -> tuple[str, str]:
        self.process.join(seconds)
        code = self.process.exitcode
        if code is None:
            self.process.kill()
            self.process.join()
        self.process.close()  # releases a file descriptor
        return _cause_of_exit(code)


def _cause_of_exit(code: int | None) -> tuple[str, str]:
    """How a process ended, and what to do, by its exit code."""
    if code is None:
        return "a thread of the worker ended", "see standard error for the cause"
    name = ended_by(code)
    if name is None:
        return f"the worker process ended with exit code {code}", "the environment or a plugin ended it"
    if name == "SIGKILL":
        return f"the worker process was killed by {name}", "probably out of memory: use fewer environments"
    return f"the worker process was killed by {name}", "standard error shows the line in native code"
