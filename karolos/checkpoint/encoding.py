"""How a state is kept in a checkpoint.

Torch's safe reader knows tensors, containers and plain values only, so a numpy array is its bytes as a tensor with
dtype and shape beside them, and a number of more than 64 bits is hexadecimal text; both lie in a dictionary with the
key `__karolos__`. A large array lies in blocks (`karolos.blocks`), and the dictionary names them. All come back bit for
bit: dtype, shape, byte order, NaN payloads, -0.0. Arrays come back in C order, mappings as plain dictionaries, tensors
on the CPU.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import torch

    from .array_files import Blocks

_TAG = "__karolos__"
_WORD = range(-(1 << 63), 1 << 63)
LARGE = 1 << 18
"""Bytes from which an array lies in blocks."""


def encode(value: Any, path: str = "state", blocks: Blocks | None = None) -> Any:
    """A state as tensors, containers and plain values; `path` names it in errors (TypeError).

    Large arrays go into `blocks`, if given.
    """
    import torch  # noqa: PLC0415

    if value is None or type(value) in {bool, str, float}:
        return value
    if type(value) is int:
        return value if value in _WORD else {_TAG: "integer", "text": hex(value)}
    if isinstance(value, torch.Tensor):
        return _own_storage(value)
    if isinstance(value, np.ndarray | np.generic):
        return _encode_array(value, path, blocks)
    if isinstance(value, Mapping):
        if _TAG in value or not all(type(key) in {str, int} for key in value):
            raise TypeError(f"{path}: keys of a state are strings or whole numbers, and none is {_TAG}")
        return {key: encode(item, f"{path}.{key}", blocks) for key, item in value.items()}
    if type(value) in {list, tuple}:
        return type(value)(encode(item, f"{path}[{index}]", blocks) for index, item in enumerate(value))
    raise TypeError(f"{path}: a checkpoint holds no {type(value).__name__}")


def decode(value: Any, blocks: Blocks | None = None) -> Any:
    """What `encode` was given; `blocks` are those it wrote to. Raises BlockError when they are not whole."""
    if isinstance(value, dict):
        if _TAG in value:
            return int(value["text"], 16) if value[_TAG] == "integer" else _decode_array(value, blocks)
        return {key: decode(item, blocks) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(decode(item, blocks) for item in value)
    return value


def _own_storage(tensor: torch.Tensor) -> torch.Tensor:
    """The tensor by itself: torch.save would write the whole storage that a view looks into."""
    alone = tensor.detach().cpu()
    return alone.clone() if alone.untyped_storage().nbytes() > alone.nbytes else alone


def _encode_array(value: np.ndarray | np.generic, path: str, blocks: Blocks | None) -> dict[str, Any]:
    import torch  # noqa: PLC0415

    array = np.asarray(value)
    if array.dtype.hasobject or array.dtype.fields:
        raise TypeError(f"{path}: a checkpoint holds no array of {array.dtype}")
    data = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
    shape = {"dtype": array.dtype.str, "shape": array.shape}
    if blocks is not None and data.nbytes >= LARGE:
        return {_TAG: "blocks", **shape, "bytes": data.nbytes, "blocks": blocks.write(data)}
    if not data.flags.writeable:  # torch warns of tensors over read-only memory
        data = data.copy()
    kind = "array" if isinstance(value, np.ndarray) else "scalar"
    return {_TAG: kind, **shape, "data": torch.from_numpy(data)}


def _decode_array(value: dict[str, Any], blocks: Blocks | None) -> Any:
    if value[_TAG] == "blocks":
        if blocks is None:
            raise ValueError("an array lies in blocks, and there are none")
        data = blocks.read(value["blocks"], value["bytes"])
    else:
        data = value["data"].numpy()
    array = data.view(np.dtype(value["dtype"])).reshape(value["shape"])
    return array[()] if value[_TAG] == "scalar" else array
