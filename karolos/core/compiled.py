"""Compiles functions by numba, which needs no compiler on the machine, and keeps them in the user's cache folder."""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

import numba
from llvmlite import binding
from numba import njit, typeof
from numba.core.caching import CompileResultCacheImpl, FunctionCache, UserWideCacheLocator
from numba.core.dispatcher import Dispatcher
from numba.extending import register_jitable

from ..errors import MachineError
from ..system.files import FileLock, user_cache

VARIABLE = "KAROLOS_CACHE"
"""Environment variable with the folder of compiled functions."""
SILENT_SECONDS, WAIT_SECONDS = 30.0, 90.0
"""Time that a process waits for another one that compiles, without a word and after it. Then it compiles, too."""

OPTIONS: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}  # the last two compile less


def compiled(function: Callable[..., Any], *, told: bool = False, fastmath: Collection[str] = ()) -> Any:
    """The function, compiled at its first call and kept on disk. One process compiles, and others load.

    Its method `unchecked` returns it as a function that checks the types of the arguments in its first call only.

    Args:
        function: in the part of Python that numba compiles. A division by zero gives inf or nan.
        told: whether lines on stderr report the compilation and its duration.
        fastmath: numba's flags that relax the rules of floating point.
    """
    dispatcher: Any = njit(**OPTIONS, fastmath=set(fastmath))(function)
    try:
        dispatcher._cache = _Cache(function, told)  # numba's own setting of a place holds for all libraries
    except (OSError, RuntimeError):
        _use_temporary_folder()
        with suppress(RuntimeError):  # nothing can be written anywhere
            dispatcher._cache = _Cache(function, told)
    compile_it = dispatcher.compile

    def compile_once(signature: Any) -> Any:
        lock = _lock(cache_folder())
        if lock.held:  # by the function that calls this one
            return compile_it(signature)
        try:
            with suppress(MachineError):  # a file system without locks: each process compiles
                if not lock.acquire(SILENT_SECONDS):
                    what = f"another process is compiling, or was stopped while it did ({lock.path})"
                    print(f"{what}: waiting", file=sys.stderr)
                    lock.acquire(WAIT_SECONDS)
            return compile_it(signature)
        finally:
            lock.release()

    dispatcher.compile = compile_once
    dispatcher.unchecked = partial(_unchecked, dispatcher)
    return dispatcher


def share(*functions: Callable[..., Any]) -> None:
    """Let compiled functions call these functions, too, which stay functions of Python and may call each other."""
    for function in functions:
        register_jitable(function)
        _shared.add(function)


_shared: set[Callable[..., Any]] = set()


def _unchecked(function: Any) -> Callable[..., Any]:
    """A compiled function whose first call checks the types of the arguments, and no other call: numba's check is slow.

    Never call it with other types later: it would not notice another kind or order of an array's numbers.
    """
    code: Callable[..., Any] | None = None

    def call(*arguments: object) -> Any:
        nonlocal code
        if code is not None:
            return code(*arguments)
        result = function(*arguments)
        code = function.get_overload(tuple(map(typeof, arguments)))
        return result

    return call


@cache
def cache_folder() -> Path:
    """Where compiled functions are kept: in `KAROLOS_CACHE`, or in the user's cache folder.

    Raises RuntimeError where no home is known.
    """
    named = os.environ.get(VARIABLE)
    folder = Path(named).expanduser().absolute() if named else user_cache()
    with suppress(OSError):  # numba tries to write, too
        folder.mkdir(0o700, parents=True, exist_ok=True)
    return folder


@cache
def _use_temporary_folder() -> None:
    """Keep compiled functions in a temporary folder, for this process and those that it starts, and say so."""
    try:
        what = f"{cache_folder()} cannot be written"
    except RuntimeError:
        what = "no home folder is known"
    print(f"{what}: each command compiles again; set {VARIABLE} to a folder that can be written", file=sys.stderr)
    os.environ[VARIABLE] = os.devnull
    with suppress(OSError):
        os.environ[VARIABLE] = folder = tempfile.mkdtemp(prefix="karolos-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    cache_folder.cache_clear()


@cache
def _lock(folder: Path) -> FileLock:
    return FileLock(folder / "lock")


@cache
def _digest(file: str) -> str:
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


class _Locator(UserWideCacheLocator):
    """Gives a function a folder, named by the processor, numba, and the content of the files of all functions it calls.

    Code of another version is therefore never loaded, and installations with the same code share the folder.
    """

    def __init__(self, py_func: Any, py_file: str) -> None:
        super().__init__(py_func, py_file)
        called = [one.py_func for one in py_func.__globals__.values() if isinstance(one, Dispatcher)]
        files = sorted({_digest(one.__code__.co_filename) for one in (py_func, *called, *_shared)})
        machine = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
        key = hashlib.sha256(repr((numba.__version__, machine, files)).encode()).hexdigest()[:16]
        self._cache_path = str(cache_folder() / key)


class _Implementation(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012  (as numba's)


class _Cache(FunctionCache):
    _impl_class = _Implementation

    def __init__(self, function: Any, told: bool) -> None:
        super().__init__(function)
        self._told, self._began = told, 0.0

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = None
        try:
            found = super().load_overload(sig, target_context)
        except Exception:  # a damaged file, of any kind
            with suppress(OSError):
                self.flush()
        if found is None:
            self._began = time.monotonic()
            self._say(f"compiling the physics (kept in {cache_folder()}) ...")
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        self._say(f"compiled in {time.monotonic() - self._began:.1f} s")
        try:
            super().save_overload(sig, data)
        except OSError as error:  # a full disk
            self._say(f"the next command compiles again: {cache_folder()} cannot be written: {error.strerror}")

    def _say(self, line: str) -> None:
        if self._told:
            print(line, file=sys.stderr, flush=True)
