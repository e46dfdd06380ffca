"""Parts and metadata of checkpoints, and equality of loaded states with their types."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

PARTS = {"agent": {"weight": torch.arange(1000.0)}, "buffer": {"slot": np.arange(50)}}
META = {"experiment": "abc", "steps": 7}


def raw(tensor: torch.Tensor) -> torch.Tensor:
    return tensor.reshape(-1).view(torch.uint8)


def same(ours: Any, theirs: Any) -> bool:
    """Equal bit for bit, types included."""
    if isinstance(ours, torch.Tensor):
        return ours.dtype == theirs.dtype and torch.equal(raw(ours), raw(theirs))
    if isinstance(ours, np.ndarray | np.generic):
        layout = (type(ours), ours.dtype, ours.shape) == (type(theirs), theirs.dtype, theirs.shape)
        return layout and ours.tobytes() == theirs.tobytes()
    if isinstance(ours, dict):
        return list(ours) == list(theirs) and all(same(ours[key], theirs[key]) for key in ours)
    if isinstance(ours, list | tuple):
        return type(ours) is type(theirs) and len(ours) == len(theirs) and all(map(same, ours, theirs))
    return type(ours) is type(theirs) and repr(ours) == repr(theirs)
