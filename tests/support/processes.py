"""Processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
from contextlib import suppress
from pathlib import Path


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
