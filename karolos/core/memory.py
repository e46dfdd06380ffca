"""Estimates of the memory that the parts of a run need."""

from __future__ import annotations

from typing import NamedTuple

FLOAT_BYTES = 4
"""Size of a float32."""


class RunSize(NamedTuple):
    """Amounts that decide how much memory a run needs."""

    environments: int
    steps: int
    """Environment steps of training."""
    batch_size: int
    demonstrations: int
    """Number of demonstrated episodes."""


class MemoryNeed(NamedTuple):
    """Memory that a part of a run certainly needs."""

    bytes: int
    what: str
    """What needs it, e.g. "a buffer of 1,000 transitions"."""
    setting: str
    """The setting that makes it large, e.g. "buffer.capacity"."""
