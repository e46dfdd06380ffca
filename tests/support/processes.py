"""Processes of this machine."""

import multiprocessing
import os
import signal
import subprocess
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep
from typing import Any, TypeVar

from support.fork_server import SERVER

Found = TypeVar("Found")


def child_processes() -> list[int]:
    """The ids of this process's children, without the server of tests/support/fork_server.py."""
    found, server = [], SERVER.process
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended meanwhile
            parent = int(path.read_text().rpartition(")")[2].split()[1])
            if parent == os.getpid():
                found.append(int(path.parent.name))
    return [child for child in found if server is None or child != server.pid]


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
    wait_for(lambda: not any(map(_is_alive, pids)), 20)


def _is_alive(pid: int) -> bool:
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


class Here(Executor):
    """What a pool of processes does, in this process: each of them would import everything."""

    def __init__(self, *_: object, **__: object) -> None:
        pass

    def submit(self, function: Callable[..., Found], /, *arguments: Any, **options: Any) -> Future[Found]:
        future: Future[Found] = Future()
        future.set_result(function(*arguments, **options))
        return future
