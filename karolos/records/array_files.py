"""Array files: large arrays of checkpoints in files of 1 MiB that are named by their content.

A replay buffer of a gigabyte changes little between two checkpoints. Only the files that changed are written, and
checkpoints share the others. A file is complete or missing: it is written under another name and renamed.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from .. import system

SIZE = 1 << 20
"""Bytes of a file; the last one of an array is shorter."""
_NAME = re.compile(r"[0-9a-f]{64}")
_SOUND: set[Path] = set()
"""Files that this process has written or compared, and need not read again."""


class ArrayFileError(ValueError):
    """An array file that is missing, damaged or has an invalid name."""


class ArrayFiles:
    """The array files in one folder, which is created with the first file."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.used: set[str] = set()
        """Names that `write` returned: `remove_unused` must keep them."""

    def write(self, data: np.ndarray) -> list[str]:
        """Write the bytes of a flat uint8 array to the disk; returns the names of its files (sha256), in order.

        Raises:
            OSError: the disk is full or the folder cannot be written; every file is complete or missing.
        """
        view = data.data
        names = [self._write_file(view[start : start + SIZE]) for start in range(0, len(view), SIZE)]
        self.used.update(names)
        return names

    def sync(self) -> None:
        """Make the names survive a power cut; called once after all files of a checkpoint are written."""
        if self.folder.is_dir():
            system.sync_folder(self.folder)

    def read(self, names: Sequence[str], size: int) -> np.ndarray:
        """The `size` bytes that `write` wrote: a flat uint8 array.

        Raises:
            ArrayFileError: a file is missing or damaged.
        """
        found = np.empty(size, np.uint8)
        start = 0
        for name in names:
            if not isinstance(name, str) or not _NAME.fullmatch(name):
                raise ArrayFileError(f"{name!r} is not the name of an array file")
            try:
                data = (self.folder / name).read_bytes()
            except OSError as error:
                raise ArrayFileError(f"the array file {name[:12]} cannot be read ({error.strerror})") from error
            if hashlib.sha256(data).hexdigest() != name or start + len(data) > size:
                raise ArrayFileError(f"the array file {name[:12]} was changed")
            found[start : start + len(data)] = np.frombuffer(data, np.uint8)
            start += len(data)
        if start != size:
            raise ArrayFileError(f"the array files hold {start:,} bytes instead of {size:,}")
        return found

    def remove_unused(self, used: Collection[str]) -> None:
        """Remove files that no checkpoint uses, also those that a killed process left incomplete."""
        if not self.folder.is_dir():
            return
        for path in self.folder.iterdir():
            if path.name not in used:
                system.remove(path, missing_ok=True)
                _SOUND.discard(path)

    def _write_file(self, data: memoryview) -> str:
        name = hashlib.sha256(data).hexdigest()
        place = self.folder / name
        complete = place.exists() and place.stat().st_size == len(data)
        if complete and (place in _SOUND or place.read_bytes() == data):  # later checkpoints would use a damaged one
            _SOUND.add(place)
            return name
        self.folder.mkdir(parents=True, exist_ok=True)
        fresh = self.folder / f".{name}.{os.getpid()}"
        with fresh.open("wb") as file:
            file.write(data)
            file.flush()
            system.sync(file.fileno())
        system.replace(fresh, place)
        _SOUND.add(place)
        return name
