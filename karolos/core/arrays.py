"""Kinds of arrays, and of states."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
FloatArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
State = dict[str, Any]
"""What a stateful part hands out and takes back: nested dicts of arrays, tensors, numbers and strings; no objects."""
