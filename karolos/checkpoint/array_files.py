"""Large arrays of checkpoints, in blocks that are named by their content and written once.

A replay buffer of a gigabyte changes little between two checkpoints. Cut into blocks, only those that changed are
written, and checkpoints share the others. A block is whole or not there: it is written beside its place, and renamed.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from ..files import sync_folder

SIZE = 1 << 20
"""Bytes of a block; the last one of an array is shorter."""
_NAME = re.compile(r"[0-9a-f]{64}")


class BlockError(ValueError):
    """A block that is missing, damaged, or not named as blocks are."""


class Blocks:
    """The blocks in one folder, which is made when the first is written."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.used: set[str] = set()
        """Names that `write` returned: what must not be swept."""

    def write(self, data: np.ndarray) -> list[str]:
        """Keep the bytes of a flat uint8 array for good; returns the names of its blocks (sha256), in order.

        Raises:
            OSError: the disk is full or the folder cannot be written; blocks are whole or not there.
        """
        view = data.data
        names = [self._write_block(view[start : start + SIZE]) for start in range(0, len(view), SIZE)]
        self.used.update(names)
        return names

    def sync(self) -> None:
        """Make the names survive a power cut; called once after all blocks of a checkpoint are written."""
        if self.folder.is_dir():
            sync_folder(self.folder)

    def read(self, names: Sequence[str], size: int) -> np.ndarray:
        """The `size` bytes that `write` was given: a flat uint8 array.

        Raises:
            BlockError: a block is missing or damaged.
        """
        found = np.empty(size, np.uint8)
        start = 0
        for name in names:
            if not isinstance(name, str) or not _NAME.fullmatch(name):
                raise BlockError(f"{name!r} is no block")
            try:
                data = (self.folder / name).read_bytes()
            except OSError as error:
                raise BlockError(f"the block {name[:12]} cannot be read ({error.strerror})") from error
            if hashlib.sha256(data).hexdigest() != name or start + len(data) > size:
                raise BlockError(f"the block {name[:12]} was changed")
            found[start : start + len(data)] = np.frombuffer(data, np.uint8)
            start += len(data)
        if start != size:
            raise BlockError(f"{start:,} bytes in blocks instead of {size:,}")
        return found

    def sweep(self, keep: Collection[str]) -> None:
        """Remove blocks that no checkpoint uses, and what a killed process left half-written."""
        if not self.folder.is_dir():
            return
        for path in self.folder.iterdir():
            if path.name not in keep:
                path.unlink(missing_ok=True)

    def _write_block(self, data: memoryview) -> str:
        name = hashlib.sha256(data).hexdigest()
        place = self.folder / name
        if place.exists() and place.stat().st_size == len(data):
            return name
        self.folder.mkdir(parents=True, exist_ok=True)
        beside = self.folder / f".{name}.{os.getpid()}"
        with beside.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, place)
        return name
