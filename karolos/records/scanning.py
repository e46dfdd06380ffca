"""Which run folders there are in a runs folder."""

from __future__ import annotations

import os
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path

from ..errors import MachineError, RunError
from .run_folder import RunFolder


def paths(runs: str | Path, pattern: str = "*") -> list[Path]:
    """The folders in a runs folder that are those of runs, sound or damaged, by name; other folders are passed over.

    Args:
        runs: the runs folder; one that is not there holds none.
        pattern: of the folders' names, as a shell's.
    """
    try:
        found = sorted(path for path in Path(runs).iterdir() if fnmatchcase(path.name, pattern))
    except FileNotFoundError:
        return []
    except OSError as error:
        raise MachineError(f"cannot be read ({error.strerror})", where=str(runs), hint="name a runs folder") from error
    return [path for path in found if os.path.isfile(path / "run.json")]


def scan(runs: str | Path, pattern: str = "*") -> Iterator[RunFolder | RunError]:
    """The run folders in a runs folder, by name; for a damaged one its error. Arguments as those of `paths`."""
    for path in paths(runs, pattern):
        try:
            yield RunFolder.open(path)
        except RunError as error:
            yield error
