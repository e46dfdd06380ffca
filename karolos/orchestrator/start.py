"""How worker processes begin: fresh, fast, and without whatever the user's own program has imported.

Linux forks them from a small server that has imported what workers need and nothing else; elsewhere each starts anew
(macOS's system libraries do not survive a fork). Either way a worker never runs the user's main module again: a script
without an `if __name__ == "__main__"` guard works, and one that imports torch does not bring it into the workers.
"""

from __future__ import annotations

import io
import multiprocessing
import os
import pickle
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext, ForkServerProcess, SpawnContext, SpawnProcess
from threading import Lock
from types import ModuleType
from typing import Any, Literal

from ..errors import PluginError
from .commands import Build
from .worker import work

WorkerProcess = ForkServerProcess | SpawnProcess

START_METHOD: Literal["forkserver", "spawn"] = "forkserver" if sys.platform == "linux" else "spawn"
ONE_THREAD = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Set to 1 in workers: they share the cores as processes, and libraries that each take all cores fight."""

_starting = Lock()


class _Modules(pickle.Unpickler):
    """Notes the modules from which a pickle takes its classes and functions."""

    def __init__(self, data: bytes) -> None:
        super().__init__(io.BytesIO(data))
        self.names: set[str] = set()

    def find_class(self, module: str, name: str) -> Any:
        self.names.add(module)
        return super().find_class(module, name)


def pack_recipe(build: Build, recipe: Any) -> bytes:
    """The pair (build, recipe), pickled for workers. Raises PluginError for what a worker could not import."""
    hint = "put it into a module of its own, or use `processes: 0` to step environments in this process"
    try:
        data = pickle.dumps((build, recipe))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise PluginError(f"cannot be handed to a worker process: {error}", where="environment", hint=hint) from error
    if "__main__" in _modules(data):
        raise PluginError(
            "is defined in the script that runs, which worker processes do not import", where="environment", hint=hint
        )
    return data


def _modules(data: bytes) -> set[str]:
    reader = _Modules(data)
    reader.load()
    return reader.names


def start_worker(number: int, recipe: bytes, ids: Sequence[range], size: int) -> tuple[WorkerProcess, list[Connection]]:
    """Start worker `number`, one thread for each range of ids; the process and the parent's ends of its connections.

    Raises OSError or EOFError when the machine gives no process.
    """
    context = _context()
    context.set_forkserver_preload(_preload(recipe))
    pairs = [context.Pipe() for _ in ids]
    theirs = [end for _, end in pairs]
    process = context.Process(
        target=work,
        args=(number, recipe, list(zip(theirs, ids, strict=True)), size),
        name=f"worker {number}",
    )
    try:
        with _fresh_start():
            process.start()
    except BaseException:
        for end, _ in pairs:
            end.close()
        raise
    finally:
        for end in theirs:
            end.close()  # so that the connection ends with the worker
    return process, [end for end, _ in pairs]


def _context() -> ForkServerContext | SpawnContext:
    if START_METHOD == "forkserver":
        return multiprocessing.get_context("forkserver")
    return multiprocessing.get_context("spawn")


def _preload(recipe: bytes) -> list[str]:
    """Karolos's own modules that the recipe needs; a third party's may start threads, which a fork would lose."""
    return [work.__module__, *sorted(name for name in _modules(recipe) if name.startswith("karolos."))]


@contextmanager
def _fresh_start() -> Iterator[None]:
    """Hide the main module from a starting process, and tell it to compute on one thread."""
    with _starting:
        main = sys.modules["__main__"]
        before = {name: os.environ.get(name) for name in ONE_THREAD}
        sys.modules["__main__"] = ModuleType("__main__")
        os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
        try:
            yield
        finally:
            sys.modules["__main__"] = main
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value
