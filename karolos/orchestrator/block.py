"""The memory in which seeds and actions travel to the environments, and steps back: arrays, never pickles.

One row per environment and one array per quantity, all in one run of bytes that parent and workers map alike.
"""

from __future__ import annotations

import mmap
import os
import sys
import tempfile
from dataclasses import dataclass
from multiprocessing import reduction
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core import BoolArray, FloatArray, Signature

ALIGNMENT = 64
"""Bytes; each array begins on a cache line of its own."""


@dataclass(frozen=True)
class Block:
    """Rows of n environments: what they are told (seed, action) and what they tell (all else)."""

    seed: NDArray[np.uint64]
    action: FloatArray
    parameters: FloatArray
    observation: FloatArray
    achieved_goal: FloatArray
    desired_goal: FloatArray
    reward: FloatArray
    terminated: BoolArray
    truncated: BoolArray
    success: BoolArray
    diverged: BoolArray
    commands: NDArray[np.uint64]
    """How many commands each environment has ended: what stands still for long hangs."""

    @staticmethod
    def _columns(signature: Signature, environments: int) -> dict[str, tuple[type[np.generic], tuple[int, ...]]]:
        def wide(width: int) -> tuple[type[np.generic], tuple[int, ...]]:
            return np.float32, (environments, width)

        flag = np.bool_, (environments,)
        return {
            "seed": (np.uint64, (environments,)),
            "action": wide(signature.action.size),
            "parameters": wide(signature.parameters.size),
            "observation": wide(signature.observation.size),
            "achieved_goal": wide(signature.achieved_goal.size),
            "desired_goal": wide(signature.desired_goal.size),
            "reward": (np.float32, (environments,)),
            "terminated": flag,
            "truncated": flag,
            "success": flag,
            "diverged": flag,
            "commands": (np.uint64, (environments,)),
        }

    @classmethod
    def size(cls, signature: Signature, environments: int) -> int:
        """How much memory `environments` rows take."""
        return sum(_aligned(_bytes(*column)) for column in cls._columns(signature, environments).values())

    @classmethod
    def over(cls, buffer: Any, signature: Signature, environments: int) -> Block:
        """The arrays that lie in `buffer`, at the same places in every process."""
        arrays: dict[str, Any] = {}
        start = 0
        for name, (kind, shape) in cls._columns(signature, environments).items():
            arrays[name] = np.ndarray(shape, kind, buffer, start)
            start += _aligned(_bytes(kind, shape))
        return cls(**arrays)

    @classmethod
    def private(cls, signature: Signature, environments: int) -> Block:
        """A block in this process's own memory."""
        return cls.over(bytearray(cls.size(signature, environments)), signature, environments)


def _bytes(kind: type[np.generic], shape: tuple[int, ...]) -> int:
    return int(np.prod(shape)) * np.dtype(kind).itemsize


def _aligned(count: int) -> int:
    return -(-count // ALIGNMENT) * ALIGNMENT


class SharedBytes:
    """Memory that other processes can map and that no end of this process leaves behind.

    On POSIX it has no name: it is reached by a file descriptor alone, so that the kernel frees it with the last process
    that holds it, whatever ended the others. Windows knows only named memory, and frees it with its last handle.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        if sys.platform == "win32":
            self._named = SharedMemory(create=True, size=size)
            self.buffer = self._named.buf
            return
        if sys.platform == "linux":
            self._descriptor = os.memfd_create("karolos")
            os.ftruncate(self._descriptor, size)
        else:
            with tempfile.TemporaryFile() as file:  # has lost its name already
                file.truncate(size)
                self._descriptor = os.dup(file.fileno())
        self.buffer: Any = mmap.mmap(self._descriptor, size)

    def send(self, connection: Connection, process: int) -> None:
        """Let the process with this id, at the other end of a two-way connection, map the memory."""
        if sys.platform == "win32":
            connection.send_bytes(self._named.name.encode())
        else:
            reduction.send_handle(connection, self._descriptor, process)

    @staticmethod
    def receive(connection: Connection, size: int) -> Any:
        """The other end of `send`: a writable buffer, mapped as long as something refers to it."""
        if sys.platform == "win32":
            return _keep(SharedMemory(connection.recv_bytes().decode()))
        descriptor = reduction.recv_handle(connection)
        try:
            return mmap.mmap(descriptor, size)
        finally:
            os.close(descriptor)

    def close(self) -> None:
        """Forget the memory; it stays mapped while arrays refer to it. Safe to call twice."""
        self.buffer = None
        if sys.platform == "win32":
            return
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


_kept: list[SharedMemory] = []


def _keep(memory: SharedMemory) -> Any:
    _kept.append(memory)  # SharedMemory unmaps itself when collected, even under a live view
    return memory.buf
