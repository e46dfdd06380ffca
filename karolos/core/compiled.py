"""How functions are compiled: by numba, without a compiler on the machine, at their first call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(function: Callable[..., Any]) -> Any:
    """The function, compiled at its first call, and kept on disk where a place for it can be written."""
    try:
        return njit(nogil=True, cache=True)(function)
    except RuntimeError:  # numba's word for a disk where neither this folder nor the user's can be written
        return njit(nogil=True)(function)
