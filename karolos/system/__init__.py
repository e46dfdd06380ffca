"""Differences between Linux, macOS and Windows: locks, processes, signals, memory, files. `files` writes files safely.

No other module asks for the system. A function does the same on each system; exceptions are in its docstring.
"""

from __future__ import annotations

import _thread
import errno
import io
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Generic, TextIO, TypeVar

if TYPE_CHECKING:
    import socket
    from multiprocessing.context import BaseContext

    from _typeshed import ReadableBuffer

LINUX, MACOS, WINDOWS = (sys.platform == name for name in ("linux", "darwin", "win32"))
"""Read when a function is called, so that tests can imitate another system."""
PATIENCE_SECONDS = 2.0
"""Time for attempts to move or remove a file on Windows while a reader has it open."""
T = TypeVar("T")

# Processes and signals

STOP_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGINT", "SIGUSR1", "SIGHUP", "SIGBREAK") if hasattr(signal, name)
)
"""Signals that ask a program to end, including those of terminals and batch systems."""
REQUEUED: int | None = getattr(signal, "SIGUSR1", None)
"""The signal of a batch system that starts the job again; None on Windows."""
ALARM: signal.Signals = getattr(signal, "SIGALRM", signal.SIGABRT)
"""The signal that `set_alarm` raises."""
CLOSED_PIPE = (errno.EPIPE, errno.EINVAL) if WINDOWS else (errno.EPIPE,)
"""Error numbers of writing to a pipe whose reader has ended."""


def process_context() -> BaseContext:
    """The context of multiprocessing in which worker processes start. macOS' own libraries are not safe to fork."""
    import multiprocessing

    return multiprocessing.get_context("forkserver" if LINUX else "spawn")


if sys.platform == "win32":
    import _winapi
    import ctypes
    import msvcrt
    from ctypes import wintypes

    _KERNEL: Any = ctypes.WinDLL("kernel32", use_last_error=True)
    _KERNEL.GetCurrentProcess.restype = wintypes.HANDLE
    _KERNEL.SetPriorityClass.argtypes = wintypes.HANDLE, wintypes.DWORD
    _KERNEL.LockFileEx.argtypes = (
        (wintypes.HANDLE, wintypes.DWORD, wintypes.DWORD, wintypes.DWORD, wintypes.DWORD, ctypes.c_void_p)
    )  # fmt: skip
    _KERNEL.GetDriveTypeW.argtypes = (wintypes.LPCWSTR,)
    _BELOW_NORMAL = 0x4000
    _SYNCHRONIZE = 0x100000
    _NOW, _EXCLUSIVE, _LOCKED = 1, 2, 33
    _REMOTE = 4

    class _Overlapped(ctypes.Structure):
        _fields_ = (
            ("internal", ctypes.c_void_p * 2),
            ("offset", wintypes.DWORD),
            ("offset_high", wintypes.DWORD),
            ("event", wintypes.HANDLE),
        )

    class _Memory(ctypes.Structure):
        _fields_ = (("length", wintypes.DWORD), ("load", wintypes.DWORD), ("bytes", ctypes.c_uint64 * 7))

    def try_lock(descriptor: int, *, shared: bool = False) -> bool:
        place = _Overlapped(offset_high=0x40000000)  # one byte far beyond the end: others can read the content
        flags = _NOW | (0 if shared else _EXCLUSIVE)
        if _KERNEL.LockFileEx(msvcrt.get_osfhandle(descriptor), flags, 0, 1, 0, ctypes.byref(place)):
            return True
        if ctypes.get_last_error() == _LOCKED:
            return False
        raise ctypes.WinError(ctypes.get_last_error())

    def is_alive(process: int) -> bool:
        try:
            handle = _winapi.OpenProcess(_SYNCHRONIZE, False, process)
        except PermissionError:  # it belongs to another user
            return True
        except OSError:
            return False
        try:
            return bool(_winapi.WaitForSingleObject(handle, 0) == _winapi.WAIT_TIMEOUT)
        finally:
            _winapi.CloseHandle(handle)

    def has_ended(descriptor: int) -> bool:
        try:
            return _winapi.PeekNamedPipe(msvcrt.get_osfhandle(descriptor), 0)[0] != 0
        except BrokenPipeError:
            return True
        except OSError:
            return False

    def lower_priority(niceness: int) -> None:  # noqa: ARG001
        _KERNEL.SetPriorityClass(_KERNEL.GetCurrentProcess(), _BELOW_NORMAL)

    def _memory() -> int:
        found = _Memory(length=ctypes.sizeof(_Memory))
        _KERNEL.GlobalMemoryStatusEx(ctypes.byref(found))
        return int(found.bytes[0])

    def _share_of(path: Path) -> str | None:
        return "network" if _KERNEL.GetDriveTypeW(path.anchor) == _REMOTE else None

    def sync(descriptor: int) -> None:
        os.fsync(descriptor)

else:
    import fcntl

    def try_lock(descriptor: int, *, shared: bool = False) -> bool:
        """Lock an open file without waiting; returns whether it succeeded. The lock ends with the descriptor.

        Raises:
            OSError: the file system has no locks.
        """
        try:
            fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def is_alive(process: int) -> bool:
        """Whether a process of this machine has this id."""
        try:
            os.kill(process, 0)
        except (ProcessLookupError, OverflowError):
            return False
        except PermissionError:  # it belongs to another user
            pass
        return True

    def has_ended(descriptor: int) -> bool:
        """Whether the process at the other end of a pipe has ended, or has sent something. Does not wait."""
        return bool(select.select([descriptor], [], [], 0)[0])

    def lower_priority(niceness: int) -> None:
        """Lower the priority of this process, as nice(1) does; on Windows by one class of priority."""
        os.nice(niceness)

    def _memory() -> int:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")

    def _share_of(path: Path) -> str | None:
        return _share_in(path, Path("/proc/self/mounts")) if LINUX else _share_by_statfs(path)

    def sync(descriptor: int) -> None:
        """Flush an open file to the disk, so that it survives a power cut."""
        if sys.platform == "darwin":
            with suppress(OSError):  # a file system without it
                fcntl.fcntl(descriptor, fcntl.F_FULLFSYNC)  # also flushes the disk's own cache, which fsync does not
                return
        os.fsync(descriptor)


def own_group() -> dict[str, Any]:
    """Arguments of `subprocess.Popen` for a process that Ctrl-C in this terminal does not reach."""
    return {"creationflags": 0x200} if WINDOWS else {"process_group": 0}


def detached() -> dict[str, Any]:
    """Arguments of `subprocess.Popen` for a process that outlives this terminal."""
    return {"creationflags": 0x200 | 0x8} if WINDOWS else {"start_new_session": True}


def ended_by(code: int) -> str | None:
    """The signal or exception that ended a process with this exit code, e.g. SIGKILL; None: it ended by itself."""
    if code < 0:
        return signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
    return f"exception {code:#x}" if code >= 0xC0000000 else None


def on_alarm(handler: Callable[[int, FrameType | None], None]) -> Any:
    """Let ALARM call a function in the main thread, without interrupting system calls. Returns the old handler."""
    before = signal.signal(ALARM, handler)
    if hasattr(signal, "siginterrupt") and not WINDOWS:
        signal.siginterrupt(ALARM, False)
    return before


def set_alarm(seconds: float) -> None:
    """Raise ALARM periodically (in s) from now on; 0: stop. On Windows it is raised after a system call ends."""
    if hasattr(signal, "setitimer") and not WINDOWS:
        signal.setitimer(signal.ITIMER_REAL, seconds, seconds)
        return
    while _alarms:
        _alarms.pop().set()
    if seconds:
        _alarms.append(threading.Event())
        threading.Thread(target=_raise_alarm, args=(seconds, _alarms[-1]), daemon=True).start()


def _raise_alarm(seconds: float, over: threading.Event) -> None:
    while not over.wait(seconds):
        _thread.interrupt_main(ALARM)


_alarms: list[threading.Event] = []


def user_cache() -> Path:
    """The cache folder of this user. Raises RuntimeError if there is no known home."""
    named = os.environ.get("LOCALAPPDATA" if WINDOWS else "XDG_CACHE_HOME", "")
    usual = "~/AppData/Local" if WINDOWS else "~/Library/Caches" if MACOS else "~/.cache"
    return Path(named if Path(named).is_absolute() else usual).expanduser()


# The machine


def cores(jobs: int = 1) -> int:
    """CPU cores for each of `jobs` processes: an equal share of the usable cores, at least 1.

    On Linux a job scheduler restricts a process to the cores of its job.
    """
    return max((len(os.sched_getaffinity(0)) if LINUX else os.cpu_count() or 1) // jobs, 1)


def memory() -> int:
    """Memory of the machine in bytes; on Linux at most that of the process's control group (a container)."""
    limits = [_memory()]
    for file in _limit_files():
        with suppress(OSError, ValueError):  # "max": without a limit
            limits.append(int(file.read_text("utf-8")))
    return min(limits)


def _limit_files() -> Iterator[Path]:
    """The files with the memory limits of this process's control groups, of version 2 and of version 1."""
    try:
        lines = Path("/proc/self/cgroup").read_text("utf-8").splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, name = line.split(":", 2)
        root, file = Path("/sys/fs/cgroup"), "memory.max"
        if controllers == "memory":
            root, file = root / "memory", "memory.limit_in_bytes"
        elif controllers:
            continue
        own = root / name.lstrip("/")
        yield from (folder / file for folder in (own, *own.parents) if root in (folder, *folder.parents))


def has_display() -> bool:
    """Whether a window can be shown."""
    return not LINUX or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


RENDERERS = ("egl", "osmesa") if LINUX else ("glfw",) if WINDOWS else ("cgl",)
"""MuJoCo's modules for pictures, in the order of attempts."""
RENDERER_HINT = (
    "apt install libegl1 libgl1-mesa-dri, or libosmesa6; and pip install pyopengl"
    if LINUX
    else "pip install glfw pyopengl"
    if WINDOWS
    else "pip install pyopengl, and stay logged in at the screen"
)


def listen_alone(listener: socket.socket) -> None:
    """Reserve the port for this program, and free it for the next one as soon as this one ends."""
    import socket

    exclusive = getattr(socket, "SO_EXCLUSIVEADDRUSE", None)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR if exclusive is None else exclusive, 1)


def use_utf8() -> None:
    """Allow printing of any character: in UTF-8 on Windows, and escaped if the encoding of another system lacks it."""
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")
    if WINDOWS:
        for stream in (sys.stdout, sys.stderr):
            stream.reconfigure(encoding="utf-8", errors="replace")  # type: ignore[union-attr]


class _Lossy(io.FileIO):
    """A descriptor whose failed writes are lost without an error."""

    def write(self, data: ReadableBuffer, /) -> int:
        try:
            return super().write(data)
        except OSError:
            return memoryview(data).nbytes


def unfailing(stream: TextIO) -> TextIO:
    """The process's own stderr, so that a full disk or a reader that has ended loses lines, but ends no run.

    Another stream, and a terminal of Windows, is returned as it is.
    """
    if stream is not sys.__stderr__ or (WINDOWS and stream.isatty()):
        return stream
    buffer = io.BufferedWriter(_Lossy(stream.fileno(), "wb", closefd=False))
    return io.TextIOWrapper(buffer, stream.encoding, stream.errors, line_buffering=True)


# Files


BINARY: int = getattr(os, "O_BINARY", 0)
"""A flag of `os.open` for binary files."""
RESERVED_NAMES = frozenset(("con prn aux nul " + " ".join(f"com{n} lpt{n}" for n in range(1, 10))).split())
"""Reserved names on Windows, with any ending."""


def sync_folder(folder: Path) -> None:
    """Flush the names in a folder to the disk. Windows does so itself."""
    if WINDOWS:
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        sync(descriptor)
    finally:
        os.close(descriptor)


def replace(source: str | Path, target: str | Path) -> None:
    """Move a file over another one, or a folder to a free name, as os.replace does."""
    _patiently(lambda: os.replace(source, target))


def remove(path: str | Path, *, missing_ok: bool = False) -> None:
    """Remove a file."""
    with suppress(*([FileNotFoundError] if missing_ok else [])):
        _patiently(lambda: os.unlink(path))


def remove_tree(path: str | Path, *, ignore_errors: bool = False) -> None:
    """Remove a folder with its content."""
    import shutil

    with suppress(*([OSError] if ignore_errors else [])):
        _patiently(lambda: shutil.rmtree(path))


def _patiently(change: Callable[[], None]) -> None:
    """Change a file; on Windows repeat until no reader has it open."""
    deadline = time.monotonic() + PATIENCE_SECONDS
    while True:
        try:
            change()
        except PermissionError:
            if not WINDOWS or time.monotonic() >= deadline:
                raise
            time.sleep(0.02)
        else:
            return


def is_own(status: os.stat_result) -> bool:
    """Whether a file belongs to the user of this process; true of all files on Windows."""
    return WINDOWS or status.st_uid == os.getuid()


NETWORK_SHARES = ("nfs", "nfs4", "cifs", "smb3", "smbfs", "fuse.sshfs")
"""Types of file systems whose locks cannot be trusted."""
_LOCAL = 0x1000
"""MNT_LOCAL of macOS' statfs."""


def network_share(path: Path) -> str | None:
    """The type of the network share that contains a path; None if it is on a disk of this machine, or unknown."""
    return _share_of(path.resolve())


def _share_in(path: Path, mounts: Path) -> str | None:
    try:
        lines = [line.split() for line in mounts.read_text("utf-8").splitlines()]
    except OSError:
        return None
    found = {len(line[1]): line[2] for line in lines if path.is_relative_to(line[1].replace("\\040", " "))}
    kind = found[max(found)] if found else ""
    return kind if kind in NETWORK_SHARES else None


def _share_by_statfs(path: Path) -> str | None:
    """As `network_share` on macOS. Source: sys/mount.h, struct statfs with 64-bit inodes: f_flags, f_fstypename."""
    import ctypes

    found = (ctypes.c_char * 4096)()
    call = getattr(ctypes.CDLL(None), "statfs", None)
    while not path.exists():
        path = path.parent
    if call is None or call(os.fsencode(path), found):
        return None
    local = int.from_bytes(found.raw[64:68], sys.byteorder) & _LOCAL
    return None if local else found.raw[72:88].split(b"\0")[0].decode()


# Waiting for workers, and memory that is shared with them


class Poller(Generic[T]):
    """Waits for connections of multiprocessing with a message or an end. Twice as fast as a selector of Python."""

    def __init__(self) -> None:
        self._items: dict[int, tuple[Any, T]] = {}
        self._poll = select.poll() if hasattr(select, "poll") and not WINDOWS else None

    def add(self, one: Any, item: T) -> None:
        """Also wait for this connection; `item` identifies it."""
        self._items[one.fileno()] = one, item
        if self._poll is not None:
            self._poll.register(one, select.POLLIN)

    def remove(self, one: Any) -> None:
        """Stop waiting for a connection that is still open."""
        del self._items[one.fileno()]
        if self._poll is not None:
            self._poll.unregister(one)

    def ready(self, seconds: float) -> list[T]:
        """The items whose connections can be read; waits up to `seconds` for one."""
        if self._poll is not None:
            return [self._items[number][1] for number, _ in self._poll.poll(1e3 * seconds)]
        from multiprocessing import connection

        try:
            found = connection.wait([one for one, _ in self._items.values()], seconds)
        except InterruptedError:  # Ctrl-C on Windows: its handler has run
            return []
        return [item for one, item in self._items.values() if one in found]


class SharedMemory:
    """Memory that other processes can map. The system frees it after the last process."""

    def __init__(self, size: int) -> None:
        import mmap
        import secrets
        import tempfile

        self._descriptor, self._name = -1, f"karolos-{os.getpid()}-{secrets.token_hex(8)}"
        self.buffer: Any
        if sys.platform == "win32":
            self.buffer = mmap.mmap(-1, size, tagname=self._name)
            return
        if MACOS:
            self._descriptor, path = tempfile.mkstemp()
            os.unlink(path)
        else:
            self._descriptor = os.memfd_create("karolos")
        os.ftruncate(self._descriptor, size)
        self.buffer = mmap.mmap(self._descriptor, size)

    def send(self, one: Any) -> None:
        """Let the process at the other end of the connection map the memory."""
        if sys.platform == "win32":
            one.send(self._name)
        else:
            from multiprocessing import reduction

            reduction.send_handle(one, self._descriptor, 0)

    @staticmethod
    def receive(one: Any, size: int) -> Any:
        """Receive the memory from `send`: a writable buffer, mapped as long as it is referenced."""
        import mmap
        from multiprocessing import reduction

        if sys.platform == "win32":
            return mmap.mmap(-1, size, tagname=one.recv())
        descriptor = reduction.recv_handle(one)
        try:
            return mmap.mmap(descriptor, size)
        finally:
            os.close(descriptor)

    def close(self) -> None:
        """Release the memory; it stays mapped while arrays refer to it. Safe to call twice."""
        self.buffer = None
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
