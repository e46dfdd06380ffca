"""What the run folders say, read by one or several processes: most of the time goes into their JSON."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ..errors import RunError
from ..run_folder import RunFolder, paths
from .writing import Entry

FEW = 200
"""Run folders that one process has read before others have started."""
_AT_ONCE = 25


@dataclass(frozen=True)
class Found:
    """A run folder; `entry` None where it is damaged or `alive`, and `problems` say what is wrong with it."""

    name: str
    run: str | None
    entry: Entry | None
    alive: bool
    problems: tuple[str, ...]


def read_folders(root: Path, jobs: int = 1, *, living: bool = True) -> Iterator[Found]:
    """The run folders in a runs folder, by name.

    Args:
        root: the runs folder.
        jobs: processes to read with; several only pay where there are many folders.
        living: read folders that a process is working on, too.
    """
    found = paths(root)
    if jobs == 1 or len(found) <= FEW:
        yield from (_read(path, living) for path in found)
        return
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(_read, found, [living] * len(found), chunksize=_AT_ONCE)


def _read(path: Path, living: bool) -> Found:
    try:
        folder = RunFolder.open(path)
    except RunError as error:
        return Found(path.name, None, None, False, (str(error),))
    alive = folder.is_locked()
    if alive and not living:
        return Found(path.name, folder.id, None, True, ())
    record = folder.record()
    problems = tuple(f"{path.name}: {problem}" for problem in record.problems)
    return Found(path.name, folder.id, Entry.of(record), alive, problems)
