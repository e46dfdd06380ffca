"""Files that are whole or not there, lines that are appended for good, and locks that die with their process.

Whatever the operating system refuses while writing becomes a MachineError that says what to do.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from .errors import MachineError, UsageError

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
_FORBIDDEN = frozenset({errno.EACCES, errno.EPERM, errno.EROFS})
_POLL_SECONDS = 0.02


class Lines(NamedTuple):
    """What a file of JSON lines holds; `problems` names each line that could not be read, one text per line."""

    rows: tuple[dict[str, Any], ...]
    problems: tuple[str, ...]


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an OSError of the block into a MachineError about `path`."""
    try:
        yield
    except OSError as error:
        raise _explained(error, path) from error


def _explained(error: OSError, path: Path) -> MachineError:
    if error.errno in _FULL:
        return MachineError("the disk is full", where=str(path), hint="free some space; what was there before is whole")
    if error.errno in _FORBIDDEN:
        return MachineError("cannot be written", where=str(path), hint="change its permissions or name another folder")
    if isinstance(error, NotADirectoryError | FileExistsError):
        return MachineError("a file is in the way of a folder", where=str(path), hint="name another folder")
    return MachineError(f"cannot be written ({error.strerror or error})", where=str(path))


def below(root: Path, name: str) -> Path:
    """`root / name`, which must lie below `root` once links are followed.

    Raises:
        UsageError: it does not.
    """
    path = root / name
    if path.resolve() == root.resolve() or not path.resolve().is_relative_to(root.resolve()):
        raise UsageError(f"{name!r} leads out of {root}", hint="give a plain name")
    return path


def sync_folder(folder: Path) -> None:
    """Make the names in a folder survive a power cut. Windows has no such call and does it by itself."""
    if sys.platform != "win32":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def write_whole(path: Path, text: str) -> None:
    """Write a file so that a reader sees the old or the new content and never a part of it.

    Raises:
        MachineError: the disk is full or the folder cannot be written; the old content is kept.
    """
    beside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    with writing(path):
        try:
            with beside.open("w", encoding="utf-8", newline="\n") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            os.replace(beside, path)
        finally:
            beside.unlink(missing_ok=True)  # gone already unless something went wrong
        sync_folder(path.parent)


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write a JSON object as `write_whole` does, for people to read."""
    write_whole(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def append_lines(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Append JSON objects, one a line, and wait until they are on the disk.

    A torn line that a killed process left at the end is cut off first, so that it never joins a new one.

    Raises:
        MachineError: the disk is full or the file cannot be written; the lines before are kept as they are.
    """
    lines = "".join(json.dumps(row, separators=(",", ":"), allow_nan=False) + "\n" for row in rows).encode()
    with writing(path):
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o666)
        try:
            end = _cut_torn_line(descriptor)
            try:
                _write_all(descriptor, lines)
                os.fsync(descriptor)
            except OSError:
                with contextlib.suppress(OSError):  # the first error is the one to tell
                    os.ftruncate(descriptor, end)
                raise
        finally:
            os.close(descriptor)


def _write_all(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]


def _cut_torn_line(descriptor: int) -> int:
    """Leave the file ending in a whole line; returns its size."""
    size = end = os.fstat(descriptor).st_size
    tail = b""
    while end and b"\n" not in tail:
        start = max(end - 65536, 0)
        os.lseek(descriptor, start, os.SEEK_SET)
        tail = os.read(descriptor, end - start) + tail
        end = start
    torn = len(tail) - (tail.rfind(b"\n") + 1)
    if torn:
        size -= torn
        os.ftruncate(descriptor, size)
    return size


def read_lines(path: Path) -> Lines:
    """The JSON objects of a file of lines. A line that is torn or no object is left out and named; no file is empty."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return Lines((), ())
    except OSError as error:
        return Lines((), (f"{path.name}: cannot be read ({error.strerror})",))
    rows: list[dict[str, Any]] = []
    problems: list[str] = []
    *whole, rest = data.split(b"\n")
    for number, line in enumerate(whole, 1):
        row = parse_object(line)
        if row is None:
            problems.append(f"{path.name}:{number}: not a JSON object; left out")
        else:
            rows.append(row)
    if rest:
        problems.append(f"{path.name}:{len(whole) + 1}: the last line is torn; left out")
    return Lines(tuple(rows), tuple(problems))


def parse_object(data: bytes) -> dict[str, Any] | None:
    """A JSON object, or None for anything else."""
    try:
        value = json.loads(data)
    except (ValueError, RecursionError):  # UnicodeDecodeError and JSONDecodeError are ValueErrors
        return None
    return value if isinstance(value, dict) else None


class FileLock:
    """An exclusive lock on a file. The operating system frees it when its process ends, however it ends."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._descriptor: int | None = None

    @property
    def held(self) -> bool:
        """Whether this very object holds the lock."""
        return self._descriptor is not None

    def acquire(self, seconds: float = 0.0) -> bool:
        """Try for `seconds` to get the lock; says whether it was got.

        Raises:
            MachineError: the file cannot be made or its file system has no locks.
        """
        if self.held:
            return True
        with writing(self.path):
            descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o666)
            try:
                deadline = time.monotonic() + seconds
                while not _try_lock(descriptor, exclusive=True):
                    if time.monotonic() >= deadline:
                        os.close(descriptor)
                        return False
                    time.sleep(_POLL_SECONDS)
            except BaseException:
                os.close(descriptor)
                raise
        self._descriptor = descriptor
        return True

    def release(self) -> None:
        """Give the lock back. Safe to call twice."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def is_locked(self) -> bool:
        """Whether any process holds the lock. Takes a shared lock for an instant, so that readers do not disturb."""
        if self.held:
            return True
        try:
            descriptor = os.open(self.path, os.O_RDONLY)
        except OSError:
            return False
        try:
            return not _try_lock(descriptor, exclusive=False)
        except OSError:
            return False  # a file system without locks has none to hold
        finally:
            os.close(descriptor)


def _try_lock(descriptor: int, *, exclusive: bool) -> bool:
    try:
        if sys.platform == "win32":
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(descriptor, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in {errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES, errno.EDEADLK}:
            return False
        raise
    return True
