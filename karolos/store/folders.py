"""Reading the folders of runs and sweeps for the index; several processes read many of them faster."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ..errors import RunError
from ..records import RunFolder, paths
from ..records.run_records import RunRecord
from ..records.sweep_records import SweepRecord, read_sweep, sweep_paths

FEW = 200
"""Up to this many run folders are read by one process; more processes take longer to start than to read them."""
_FOLDERS_PER_TASK = 25


@dataclass(frozen=True)
class FoundFolder:
    """A run folder; `run` and `record` are None if it is damaged, `record` also if it is locked."""

    name: str
    run: str | None
    record: RunRecord | None
    problems: tuple[str, ...]


def read_folders(root: Path, jobs: int = 1, *, locked: bool = True) -> Iterator[FoundFolder]:
    """The run folders in a runs folder, by name; of two folders of one run, the second is named as a problem.

    Args:
        root: the runs folder.
        jobs: processes that read them.
        locked: also read folders of runs that a process is working on.
    """
    known: dict[str, str] = {}
    for found in _read_all(paths(root), jobs, locked):
        other = known.setdefault(found.run, found.name) if found.run is not None else found.name
        if other == found.name:
            yield found
        else:
            problem = f"{found.name}: says that it is the run {found.run}, as {other} does; left out"
            yield FoundFolder(found.name, None, None, (problem,))


def _read_all(found: list[Path], jobs: int, locked: bool) -> Iterator[FoundFolder]:
    if jobs == 1 or len(found) <= FEW:
        yield from (_read(path, locked) for path in found)
        return
    import multiprocessing  # noqa: PLC0415  (both take longer to import than a query takes)
    from concurrent.futures import ProcessPoolExecutor  # noqa: PLC0415

    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(_read, found, [locked] * len(found), chunksize=_FOLDERS_PER_TASK)


def _read(path: Path, locked: bool) -> FoundFolder:
    try:
        folder = RunFolder.open(path)
    except RunError as error:
        return FoundFolder(path.name, None, None, (str(error),))
    if not locked and folder.is_locked():
        return FoundFolder(path.name, folder.id, None, ())
    record = folder.record()
    return FoundFolder(path.name, folder.id, record, tuple(f"{path.name}: {problem}" for problem in record.problems))


def read_sweeps(root: Path) -> tuple[tuple[SweepRecord, ...], tuple[str, ...]]:
    """The sweeps in a runs folder by folder name, each once, and one line per damaged file."""
    found: dict[str, SweepRecord] = {}
    problems: list[str] = []
    for path in sweep_paths(root):
        try:
            record, damaged = read_sweep(path)
        except RunError as error:
            problems.append(str(error))
            continue
        problems += damaged
        known = found.setdefault(record.sweep, record)
        if known is not record:
            other = Path(known.folder).name
            problems.append(f"{path.name}: says that it is the sweep {record.sweep}, as {other} does; left out")
    return tuple(found.values()), tuple(problems)


def is_gone(folder: str, home: Path) -> bool:
    """Whether a folder that stood in `home` does not exist any more."""
    path = Path(folder)
    return path.parent == home and not path.exists()
