"""Processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep


def child_processes() -> list[int]:
    """The ids of this process's children."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended meanwhile
            parent = int(path.read_text().rpartition(")")[2].split()[1])
            if parent == os.getpid():
                found.append(int(path.parent.name))
    return found


def kill_worker(number: int) -> None:
    """Kill a worker process of the orchestrator, and wait for its end."""
    (worker,) = [child for child in multiprocessing.active_children() if child.name == f"worker {number}"]
    worker.kill()
    worker.join()


def wait_until_gone(*pids: int) -> None:
    """Wait until these processes have ended."""
    deadline = monotonic() + 20
    while left := [pid for pid in pids if _is_alive(pid)]:
        assert monotonic() < deadline, f"still there: {left}"
        sleep(0.02)


def _is_alive(pid: int) -> bool:
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False
