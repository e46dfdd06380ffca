"""Shared memory between parent and workers: seeds and actions to the environments, steps back, without pickling.

There is one array per quantity with one row per environment. All arrays are in one block of memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core import FloatArray, Signature, Step

ALIGNMENT = 64
"""Each array begins at a multiple of these bytes, so that arrays never share a cache line."""


@dataclass(frozen=True)
class EnvironmentArrays:
    """One row per environment. The parent writes `seed` and `action`, the environments write the other arrays."""

    seed: NDArray[np.uint64]
    action: FloatArray
    parameters: FloatArray
    measures: FloatArray
    """The measures of the episode that each environment ended last."""
    commands: NDArray[np.uint64]
    """Number of commands that each environment has completed. A hanging environment completes none."""
    step: Step

    @staticmethod
    def size(signature: Signature, environments: int) -> int:
        """Bytes that the arrays of `environments` environments need."""
        return sum(_aligned(_bytes(*column)) for column in _columns(signature, environments))

    @classmethod
    def over(cls, buffer: Any, signature: Signature, environments: int) -> EnvironmentArrays:
        """The arrays in `buffer`, at the same offsets in every process."""
        arrays: list[Any] = []
        start = 0
        for kind, shape in _columns(signature, environments):
            arrays.append(np.ndarray(shape, kind, buffer, start))
            start += _aligned(_bytes(kind, shape))
        seed, action, parameters, measures, commands, *step = arrays
        return cls(seed, action, parameters, measures, commands, Step(*step))

    @classmethod
    def private(cls, signature: Signature, environments: int) -> EnvironmentArrays:
        """Arrays in the private memory of this process."""
        return cls.over(bytearray(cls.size(signature, environments)), signature, environments)


def _columns(signature: Signature, environments: int) -> list[tuple[type[np.generic], tuple[int, ...]]]:
    """Type and shape of each array: seed, action, parameters, measures and commands, then those of a Step."""
    count = np.uint64, (environments,)
    widths = signature.action.size, signature.parameters.size, len(signature.measures)
    action, parameters, measures = ((np.float32, (environments, width)) for width in widths)
    step = ((array.dtype.type, array.shape) for array in Step.zeros(signature, environments))
    return [count, action, parameters, measures, count, *step]


def _bytes(kind: type[np.generic], shape: tuple[int, ...]) -> int:
    return int(np.prod(shape)) * np.dtype(kind).itemsize


def _aligned(count: int) -> int:
    return -(-count // ALIGNMENT) * ALIGNMENT
