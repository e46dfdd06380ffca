"""Processes of this machine."""

import multiprocessing
import os
import signal
import subprocess
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, Future
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep
from typing import Any, NamedTuple, TypeVar

from support.fork_server import SERVER

Found = TypeVar("Found")


class Process(NamedTuple):
    """The parent and the session of a process."""

    parent: int
    session: int


def living() -> dict[int, Process]:
    """The processes of this machine by their ids, without those that only wait for their parents."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended meanwhile
            # After the name in brackets: state, parent, group, session.
            state, parent, _, session, *_ = path.read_text().rpartition(")")[2].split()
            if state != "Z":
                found[int(path.parent.name)] = Process(int(parent), int(session))
    return found


def child_processes() -> list[int]:
    """The ids of this process's children, without the server of tests/support/fork_server.py."""
    server = SERVER.process
    children = [pid for pid, process in living().items() if process.parent == os.getpid()]
    return [child for child in children if server is None or child != server.pid]


def holders(locks: Iterable[Path]) -> list[int]:
    """The processes that hold these files locked."""
    inodes = {path.stat().st_ino for path in locks}
    # A line of a held lock: "1: FLOCK ADVISORY WRITE 4242 08:01:123456 0 EOF"; of one waited for: "1: -> FLOCK ..."
    held = [line.split() for line in Path("/proc/locks").read_text().splitlines() if "->" not in line]
    return [int(words[4]) for words in held if int(words[5].rpartition(":")[2]) in inodes]


def kill_worker(number: int) -> None:
    """Kill a worker process of the orchestrator, and wait for its end."""
    (worker,) = [child for child in multiprocessing.active_children() if child.name == f"worker {number}"]
    worker.kill()
    worker.join()


def wait_for(holds: Callable[[], Found], seconds: float = 120.0) -> Found:
    """Wait until it holds; what it gives then."""
    deadline = monotonic() + seconds
    while not (found := holds()):
        assert monotonic() < deadline, "it never holds"
        sleep(0.01)
    return found


def killed_when(holds: Callable[[], object], command: Sequence[str], *, alone: bool = False, **how: Any) -> None:
    """Start a command and kill it, before its end, as soon as this holds; and what it has started, but if `alone`."""
    with subprocess.Popen(command, start_new_session=True, **how) as process:
        wait_for(lambda: holds() or process.poll() is not None, 300)
        (os.kill if alone else os.killpg)(process.pid, signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL


def wait_until_gone(*pids: int) -> None:
    """Wait until these processes have ended."""
    wait_for(lambda: not living().keys() & {*pids}, 20)


class Here(Executor):
    """What a pool of processes does, in this process: each of them would import everything."""

    def __init__(self, *_: object, **__: object) -> None:
        pass

    def submit(self, function: Callable[..., Found], /, *arguments: Any, **options: Any) -> Future[Found]:
        future: Future[Found] = Future()
        future.set_result(function(*arguments, **options))
        return future
