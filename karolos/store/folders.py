"""What the folders of runs and sweeps say. Those of many runs are read by several processes: their JSON takes time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ..errors import RunError
from ..records import RunFolder, paths, sweep_reading
from ..records.sweep_records import SweepRecord
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
    import multiprocessing  # noqa: PLC0415  (both take longer to import than the index takes to answer)
    from concurrent.futures import ProcessPoolExecutor  # noqa: PLC0415

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


def read_sweeps(root: Path) -> tuple[tuple[SweepRecord, ...], tuple[str, ...]]:
    """The sweeps in a runs folder, each once, by the names of their folders; and what is damaged, one line each."""
    found: dict[str, SweepRecord] = {}
    problems: list[str] = []
    for path in sweep_reading.paths(root):
        try:
            record, damaged = sweep_reading.read(path)
        except RunError as error:
            problems.append(str(error))
            continue
        problems += damaged
        if record.sweep in found:
            other = Path(found[record.sweep].folder).name
            problems.append(f"{path.name}: says that it is the sweep {record.sweep}, as {other} does; left out")
        else:
            found[record.sweep] = record
    return tuple(found.values()), tuple(problems)


def is_gone(folder: str, home: Path) -> bool:
    """Whether a folder that lay in `home` is not there any more."""
    path = Path(folder)
    return path.parent == home and not path.exists()
