"""Types of arrays and states."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
FloatArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
State = dict[str, Any]
"""The state of a part: nested dicts of arrays, tensors, numbers and strings; no other objects."""
