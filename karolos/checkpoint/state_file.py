"""A state in a file: encoded, written by torch.save with size and hash, and read verified.

Torch's safe reader knows only tensors, containers and plain values. Therefore a numpy array is stored as a tensor of
its bytes with dtype and shape beside it, and an integer of more than 64 bits as hexadecimal text; both are dictionaries
with the key `__karolos__`. A large array is stored in array files (`karolos.checkpoint.array_files`), and the
dictionary names them. All come back bit for bit: dtype, shape, byte order, NaN payloads, -0.0. Arrays come back in C
order, mappings as plain dictionaries, tensors on the CPU. Torch is imported when a function is called.
"""

from __future__ import annotations

import hashlib
import io
import os
import pickle
from collections.abc import Mapping
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from ..core import State
from .array_files import ArrayFileError, ArrayFiles
from .manifest import CheckpointError, damaged

if TYPE_CHECKING:
    import torch

LARGE = 1 << 18
"""Bytes from which an array is stored in array files."""
_TAG = "__karolos__"
_WORD = range(-(1 << 63), 1 << 63)
_MALFORMED = (RuntimeError, ValueError, KeyError, TypeError, AttributeError, AssertionError, EOFError, OverflowError)
"""Errors of torch's reader and `decode` on files that only look like checkpoints."""


class _Sink:
    """A file that hashes its content and keeps the operating system's error, which torch replaces by another."""

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


def write_state(path: Path, state: Any) -> dict[str, Any]:
    """Write an encoded state to the disk; returns its size and hash.

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


def read_state(path: Path, facts: Any, arrays: ArrayFiles) -> State:
    """The state in a file, verified against its size and hash in the manifest and read from the same open file.

    Args:
        path: of the file.
        facts: what `write_state` returned.
        arrays: where its large arrays are stored.

    Raises:
        CheckpointError: it is missing, truncated, changed, or holds something else than a plain state.
    """
    import torch  # noqa: PLC0415

    try:
        with path.open("rb") as file:
            _verify(file, facts, path)
            file.seek(0)
            state = decode(torch.load(file, map_location="cpu", weights_only=True), arrays)
    except OSError as error:
        raise damaged(path, f"it cannot be read ({error.strerror})") from error
    except ArrayFileError as error:
        raise damaged(path, str(error)) from error
    except (pickle.UnpicklingError, *_MALFORMED) as error:
        raise CheckpointError(
            "the checkpoint does not hold a plain state and was not loaded",
            where=str(path),
            hint="it may run foreign code: do not load it by other means unless you wrote it yourself",
        ) from error
    if not isinstance(state, dict):
        raise damaged(path, "it does not hold a state")
    return state


def pack_state(state: State) -> bytes:
    """A state as bytes, for another process. Raises TypeError as `encode`."""
    import torch  # noqa: PLC0415

    file = io.BytesIO()
    torch.save(encode(state), file)
    return file.getvalue()


def unpack_state(data: bytes) -> State:
    """The inverse of `pack_state`."""
    import torch  # noqa: PLC0415

    state: State = decode(torch.load(io.BytesIO(data), map_location="cpu", weights_only=True))
    return state


def _verify(file: BufferedReader, facts: Any, path: Path) -> None:
    size = os.fstat(file.fileno()).st_size
    if size != facts["bytes"]:
        raise damaged(path, f"it has {size:,} bytes of {facts['bytes']:,}")
    if hashlib.file_digest(file, "sha256").hexdigest() != facts["sha256"]:
        raise damaged(path, "its content was changed")


def encode(value: Any, path: str = "state", arrays: ArrayFiles | None = None) -> Any:
    """A state as tensors, containers and plain values; large arrays go into `arrays`, if given.

    Raises:
        TypeError: it holds something else; `path` names it.
    """
    import torch  # noqa: PLC0415

    if value is None or type(value) in {bool, str, float}:
        return value
    if type(value) is int:
        return value if value in _WORD else {_TAG: "integer", "text": hex(value)}
    if isinstance(value, torch.Tensor):
        return _own_storage(value)
    if isinstance(value, np.ndarray | np.generic):
        return _encode_array(value, path, arrays)
    if isinstance(value, Mapping):
        if _TAG in value or not all(type(key) in {str, int} for key in value):
            raise TypeError(f"{path}: keys of a state are strings or integers other than {_TAG}")
        return {key: encode(item, f"{path}.{key}", arrays) for key, item in value.items()}
    if type(value) in {list, tuple}:
        return type(value)(encode(item, f"{path}[{index}]", arrays) for index, item in enumerate(value))
    raise TypeError(f"{path}: a checkpoint holds no {type(value).__name__}")


def decode(value: Any, arrays: ArrayFiles | None = None) -> Any:
    """The inverse of `encode`. Raises ArrayFileError if an array file is missing or damaged."""
    if isinstance(value, dict):
        if _TAG in value:
            return int(value["text"], 16) if value[_TAG] == "integer" else _decode_array(value, arrays)
        return {key: decode(item, arrays) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(decode(item, arrays) for item in value)
    return value


def _own_storage(tensor: torch.Tensor) -> torch.Tensor:
    """The tensor with its own storage: torch.save would write the whole storage of a view."""
    alone = tensor.detach().cpu()
    return alone.clone() if alone.untyped_storage().nbytes() > alone.nbytes else alone


def _encode_array(value: np.ndarray | np.generic, path: str, arrays: ArrayFiles | None) -> dict[str, Any]:
    import torch  # noqa: PLC0415

    array = np.asarray(value)
    if array.dtype.hasobject or array.dtype.fields:
        raise TypeError(f"{path}: a checkpoint holds no array of {array.dtype}")
    data = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
    shape = {"dtype": array.dtype.str, "shape": array.shape}
    if arrays is not None and data.nbytes >= LARGE:
        return {_TAG: "array_files", **shape, "bytes": data.nbytes, "files": arrays.write(data)}
    if not data.flags.writeable:  # torch warns of tensors over read-only memory
        data = data.copy()
    kind = "array" if isinstance(value, np.ndarray) else "scalar"
    return {_TAG: kind, **shape, "data": torch.from_numpy(data)}


def _decode_array(value: dict[str, Any], arrays: ArrayFiles | None) -> Any:
    if value[_TAG] == "array_files":
        if arrays is None:
            raise ValueError("an array is stored in array files, and no folder of them is given")
        data = arrays.read(value["files"], value["bytes"])
    else:
        data = value["data"].numpy()
    array = data.view(np.dtype(value["dtype"])).reshape(value["shape"])
    return array[()] if value[_TAG] == "scalar" else array
