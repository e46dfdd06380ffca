"""The machine: the cores and the memory that this process may use, and their shares."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1"
)
"""Environment variables of a process whose libraries use one thread, because several processes share the cores."""


def cores(jobs: int = 1) -> int:
    """Number of CPU cores for each of `jobs` processes: an equal share of those that this process may use, at least 1.

    A job scheduler restricts a process to the cores of its job.
    """
    return max(len(os.sched_getaffinity(0)) // jobs, 1)


def memory() -> int:
    """Bytes of memory that this process may use: the machine's, or the limit of its control group (a container)."""
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    for file in _limit_files():
        try:
            limits.append(int(file.read_text()))
        except (OSError, ValueError):  # "max": without a limit
            continue
    return min(limits)


def _limit_files() -> Iterator[Path]:
    """The files with the memory limits of this process's control groups, of version 2 and of version 1."""
    try:
        lines = Path("/proc/self/cgroup").read_text().splitlines()
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
