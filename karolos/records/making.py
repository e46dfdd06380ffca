"""New folders in a runs folder."""

from __future__ import annotations

from pathlib import Path

from ..errors import MachineError
from ..files import FileLock, writing

_FOLDERS = 10_000


def make_folder(runs: Path, stem: str) -> Path:
    """A new folder of this name, or with `-2`, `-3` ... behind it where the name is taken.

    Raises:
        MachineError: the runs folder cannot be written.
    """
    with writing(runs):
        runs.mkdir(parents=True, exist_ok=True)
        for attempt in range(1, _FOLDERS):
            path = runs / (stem if attempt == 1 else f"{stem}-{attempt}")
            try:
                path.mkdir()  # by one process only, however many try
            except FileExistsError:
                continue
            return path
    raise MachineError(f"{stem} is taken", where=str(runs))


def check_writable(runs: str | Path) -> None:
    """Make the runs folder if it is not there, and write into it.

    Raises:
        MachineError: that is not possible.
    """
    root = Path(runs)
    with writing(root):
        root.mkdir(parents=True, exist_ok=True)
        probe = FileLock(root / ".write-test")
        probe.acquire()
        probe.release()
        probe.path.unlink(missing_ok=True)
