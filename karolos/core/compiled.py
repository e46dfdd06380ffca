"""How functions are compiled: by numba, without a compiler on the machine, and kept in the user's cache folder."""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from llvmlite import binding
from numba import njit
from numba.core import event
from numba.core.caching import CompileResultCacheImpl, FunctionCache, UserWideCacheLocator
from numba.core.dispatcher import Dispatcher

from ..errors import MachineError
from ..files import FileLock
from ..system import user_cache

VARIABLE = "KAROLOS_CACHE"
"""Environment variable with the folder of compiled functions. Empty: nothing is kept."""
WAIT_SECONDS = 120.0
"""How long a process waits for another one that compiles, before it compiles, too."""

OPTIONS: Any = {
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
}  # the last two shorten what is compiled


def compiled(function: Callable[..., Any], *, told: bool = False) -> Any:
    """The function, compiled at its first call and kept on disk. One process compiles, and others load.

    Args:
        function: uses what numba knows. A division by zero gives inf or nan.
        told: whether lines on stderr say that it is compiled, and how long that took.
    """
    dispatcher: Any = njit(**OPTIONS)(function)
    folder, compile_it = cache_folder(), dispatcher.compile
    if folder is not None:
        dispatcher._cache = _Cache(function)  # numba's own setting of a place holds for all libraries
    announcement = _Announcement(dispatcher, folder) if told else None

    def compile_once(signature: Any) -> Any:
        with ExitStack() as stack:
            if folder is not None and not (lock := _lock(folder)).held:
                stack.callback(lock.release)  # first: a stop may break off anywhere
                with suppress(MachineError):  # a file system without locks: whoever comes compiles
                    lock.acquire(WAIT_SECONDS)
            if announcement is not None:
                stack.enter_context(event.install_listener("numba:compile", announcement))
            return compile_it(signature)

    dispatcher.compile = compile_once
    return dispatcher


@cache
def cache_folder() -> Path | None:
    """Where compiled functions are kept: in `KAROLOS_CACHE`, or in the user's cache folder. None: nowhere.

    If it cannot be written, a line says so, and this process and those that it starts use a temporary folder.
    """
    named = os.environ.get(VARIABLE)
    if named == "":
        return None
    folder: Path | None = None
    try:
        folder = Path(named).expanduser().absolute() if named else user_cache() / "karolos"
        folder.mkdir(0o700, parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
        return folder
    except (OSError, RuntimeError):  # the latter where nobody knows a home
        what = "no home folder is known" if folder is None else f"{folder} cannot be written"
        print(f"{what}: each command compiles again; set {VARIABLE} to a folder that can be written", file=sys.stderr)
    try:
        spare = tempfile.mkdtemp(prefix="karolos-")
        atexit.register(shutil.rmtree, spare, ignore_errors=True)
    except OSError:
        spare = ""
    os.environ[VARIABLE] = spare
    return Path(spare) if spare else None


@cache
def _lock(folder: Path) -> FileLock:
    return FileLock(folder / "lock")


@cache
def _digest(file: str) -> str:
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


class _Locator(UserWideCacheLocator):
    """Gives a function a folder named by the processor, numba, and the content of its file and of what it calls.

    So no other version's code is loaded, and installations with the same code share it.
    """

    def __init__(self, py_func: Any, py_file: str) -> None:
        super().__init__(py_func, py_file)
        called = (one.py_func for one in py_func.__globals__.values() if isinstance(one, Dispatcher))
        files = sorted({_digest(one.__code__.co_filename) for one in (py_func, *called)})
        machine = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
        key = hashlib.sha256(repr((numba.__version__, machine, files)).encode()).hexdigest()[:16]
        self._cache_path = str((cache_folder() or Path()) / key)


class _Implementation(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012  (as numba's)


class _Cache(FunctionCache):
    _impl_class = _Implementation

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # a damaged file, of any kind
            self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):  # a full disk: the next process compiles again
            super().save_overload(sig, data)

    def flush(self) -> None:
        with suppress(OSError):
            super().flush()


class _Announcement(event.Listener):
    """Says that a function is compiled, which may take some time, and how long it took."""

    def __init__(self, dispatcher: Any, folder: Path | None) -> None:
        self._dispatcher, self._folder, self._began = dispatcher, folder, 0.0

    def on_start(self, event: Any) -> None:
        if event.data["dispatcher"] is self._dispatcher:
            self._began = time.monotonic()
            kept = f" (kept in {self._folder})" if self._folder else ""
            print(f"compiling the physics{kept} ...", file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        if event.data["dispatcher"] is self._dispatcher:
            print(f"compiled in {time.monotonic() - self._began:.1f} s", file=sys.stderr, flush=True)
