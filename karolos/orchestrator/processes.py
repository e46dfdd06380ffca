"""Workers that are processes of this machine, and share memory with this one.

On Linux, workers are forked from a small server process that has imported only what they need. A worker never runs the
user's main module: a script needs no `if __name__ == "__main__"` guard, and a script that imports torch does not import
it in the workers.
"""

from __future__ import annotations

import io
import os
import pickle
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from threading import Lock
from types import ModuleType
from typing import Any

from typing_extensions import override

from ..core import BuildEnvironment, Signature
from ..errors import MachineError, PluginError
from ..system import Poller, SharedMemory, ended_by, process_context
from .executor import EnvironmentArrays
from .pool import Channel, Worker, WorkerPool
from .worker import work

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
"""Environment variables of a process whose libraries use one thread, because several processes share the cores."""
_starting = Lock()


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
    def _start(self, number: int) -> Worker:
        try:
            process, connections = start_worker(number, self._build, self._layout[number], self._size)
        except (OSError, EOFError) as error:
            raise MachineError(
                f"worker process {number} of {len(self._layout)} cannot be started: {error}",
                setting="orchestrator",
                hint="use fewer processes, or `processes: 0` to step environments in the main process",
            ) from error
        worker = Worker(number, connections, self._layout[number], partial(_end, process))
        for channel in worker.channels:
            self._poller.add(channel.connection, channel)
        return worker

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
    def _disconnect(self, worker: Worker) -> None:
        for channel in worker.channels:
            self._poller.remove(channel.connection)
        super()._disconnect(worker)

    @override
    def close(self) -> None:
        super().close()
        if self._memory is not None:
            self.arrays = EnvironmentArrays.private(self.signature, 0)  # a traceback may refer to the old arrays
            self._memory.close()


def _end(process: BaseProcess, seconds: float) -> tuple[str, str]:
    """As `Worker.end`."""
    process.join(seconds)
    code = process.exitcode
    if code is None:
        process.kill()
        process.join()
    process.close()  # releases a file descriptor
    if code is None:
        return "a thread of the worker ended", "see standard error for the cause"
    name = ended_by(code)
    if name is None:
        return f"the worker process ended with exit code {code}", "the environment or a plugin ended it"
    if name == "SIGKILL":
        return f"the worker process was killed by {name}", "probably out of memory: use fewer environments"
    return f"the worker process was killed by {name}", "standard error shows the line in native code"


class _Modules(pickle.Unpickler):
    """Records the modules of the classes and functions in a pickle."""

    def __init__(self, data: bytes) -> None:
        super().__init__(io.BytesIO(data))
        self.names: set[str] = set()
        self.load()

    def find_class(self, module: str, name: str) -> Any:
        self.names.add(module)
        return super().find_class(module, name)


def pack_build(build: BuildEnvironment) -> bytes:
    """Pickle the function for workers. Raises PluginError if a worker could not import its parts."""
    hint = "define it in a module, or use `processes: 0` to step environments in the main process"
    try:
        data = pickle.dumps(build)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise PluginError(f"cannot be sent to a worker process: {error}", setting="environment", hint=hint) from error
    if "__main__" in _Modules(data).names:
        raise PluginError(
            "is defined in the main script, which worker processes do not import", setting="environment", hint=hint
        )
    return data


def start_worker(
    number: int, packed_build: bytes, ids: Sequence[range], size: int
) -> tuple[BaseProcess, list[Connection]]:
    """Start worker `number` with one thread for each range of ids; returns the process and its connections.

    Raises OSError or EOFError if the machine cannot start a process.
    """
    context: Any = process_context()
    # Only karolos modules that the environments need: others may start threads, which do not survive a fork.
    needed = sorted(name for name in _Modules(packed_build).names if name.startswith("karolos."))
    context.set_forkserver_preload([work.__module__, *needed])  # does nothing where there is no such server
    pairs = [context.Pipe() for _ in ids]
    theirs = [end for _, end in pairs]
    process = context.Process(
        target=work, args=(number, packed_build, list(zip(theirs, ids, strict=True)), size), name=f"worker {number}"
    )
    try:
        with fresh_start():
            process.start()
    except BaseException:
        for end, _ in pairs:
            end.close()
        raise
    finally:
        for end in theirs:
            end.close()  # so that the connection ends when the worker does
    return process, [end for end, _ in pairs]


@contextmanager
def fresh_start() -> Iterator[None]:
    """Hide the main module from the new process, and set its libraries to one thread."""
    with _starting:
        main = sys.modules["__main__"]
        before = {name: os.environ.get(name) for name in ONE_THREAD}
        sys.modules["__main__"] = ModuleType("__main__")
        os.environ.update(ONE_THREAD)
        try:
            yield
        finally:
            sys.modules["__main__"] = main
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value
