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
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import system
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


def write_state(path: Path, state: State, arrays: ArrayFiles) -> dict[str, Any]:
    """Write a state to the disk, its large arrays into array files; returns the file's size and hash.

    Raises:
        OSError: the disk is full or the file cannot be written.
        TypeError: the state holds something that `encode` refuses.
    """
    data = pack_state(state, path.stem, arrays)
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        system.sync(file.fileno())
    return {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}


def read_state(path: Path, facts: Any, arrays: ArrayFiles) -> State:
    """The state in a file, verified against its size and hash in the manifest.

    Args:
        path: of the file.
        facts: what `write_state` returned.
        arrays: where its large arrays are stored.

    Raises:
        CheckpointError: it is missing, truncated, changed, or holds something else than a plain state.
    """
    try:
        data = path.read_bytes()
        if len(data) != facts["bytes"]:
            raise damaged(path, f"it has {len(data):,} bytes of {facts['bytes']:,}")
        if hashlib.sha256(data).hexdigest() != facts["sha256"]:
            raise damaged(path, "its content was changed")
        state = unpack_state(data, arrays)
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


def pack_state(state: State, path: str = "state", arrays: ArrayFiles | None = None) -> bytes:
    """A state as bytes, for a file or another process. Arguments and errors are those of `encode`."""
    import torch  # noqa: PLC0415

    file = io.BytesIO()
    torch.save(encode(state, path, arrays), file)
    return file.getvalue()


def unpack_state(data: bytes, arrays: ArrayFiles | None = None) -> State:
    """The inverse of `pack_state`."""
    import torch  # noqa: PLC0415

    state: State = decode(torch.load(io.BytesIO(data), map_location="cpu", weights_only=True), arrays)
    return state


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
