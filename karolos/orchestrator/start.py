"""Start of worker processes, without the modules that the user's program has imported.

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
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from threading import Lock
from types import ModuleType
from typing import Any

from ..core import BuildEnvironment
from ..errors import PluginError
from ..system import process_context
from .worker import work

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
"""Environment variables of a process whose libraries use one thread, because several processes share the cores."""
_starting = Lock()


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
