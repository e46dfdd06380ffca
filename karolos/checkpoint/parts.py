"""One part of a checkpoint in a file: written with size and hash, read verified. Torch is imported when called."""

from __future__ import annotations

import hashlib
import os
import pickle
from io import BufferedReader
from pathlib import Path
from typing import Any, BinaryIO

from ..core import State
from .array_files import BlockError, Blocks
from .encoding import decode
from .errors import CheckpointError, damaged

_MALFORMED = (RuntimeError, ValueError, KeyError, TypeError, AttributeError, AssertionError, EOFError, OverflowError)
"""What torch's reader and `decode` raise on files that were made to look like checkpoints."""


class _Sink:
    """A file that hashes what is written to it and keeps the system's own error, which torch replaces by another."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._sha256 = hashlib.sha256()
        self.size = 0
        self.error: OSError | None = None

    def write(self, data: bytes | memoryview) -> int:
        try:
            self._file.write(data)
        except OSError as error:
            self.error = error
            raise
        self._sha256.update(data)
        self.size += len(data)
        return len(data)

    def flush(self) -> None:
        self._file.flush()

    def facts(self) -> dict[str, Any]:
        return {"bytes": self.size, "sha256": self._sha256.hexdigest()}


def write_part(path: Path, state: Any) -> dict[str, Any]:
    """Write one part, as `encode` made it, for good; returns its size and hash.

    Raises:
        OSError: the disk is full or the file cannot be written.
    """
    import torch  # noqa: PLC0415

    with path.open("wb") as file:
        sink = _Sink(file)
        try:
            torch.save(state, sink)  # type: ignore[arg-type]  # it writes and never seeks
        except RuntimeError as error:
            if sink.error is None:
                raise
            raise sink.error from error
        file.flush()
        os.fsync(file.fileno())
    return sink.facts()


def read_part(path: Path, facts: Any, blocks: Blocks) -> State:
    """One part, verified against its size and hash in the manifest and read from the same open file.

    Args:
        path: of the file.
        facts: what `write_part` returned.
        blocks: where large arrays lie.

    Raises:
        CheckpointError: it is missing, truncated, changed, or holds what is no plain state.
    """
    import torch  # noqa: PLC0415

    try:
        with path.open("rb") as file:
            _verify(file, facts, path)
            file.seek(0)
            state = decode(torch.load(file, map_location="cpu", weights_only=True), blocks)
    except OSError as error:
        raise damaged(path, f"it cannot be read ({error.strerror})") from error
    except BlockError as error:
        raise damaged(path, str(error)) from error
    except (pickle.UnpicklingError, *_MALFORMED) as error:
        raise CheckpointError(
            "the checkpoint holds what is no plain state, and was not loaded",
            where=str(path),
            hint="it may run foreign code: do not load it by other means unless you wrote it yourself",
        ) from error
    if not isinstance(state, dict):
        raise damaged(path, "it holds no state")
    return state


def _verify(file: BufferedReader, facts: Any, path: Path) -> None:
    size = os.fstat(file.fileno()).st_size
    if size != facts["bytes"]:
        raise damaged(path, f"it has {size:,} bytes of {facts['bytes']:,}")
    if hashlib.file_digest(file, "sha256").hexdigest() != facts["sha256"]:
        raise damaged(path, "its content was changed")
