"""Backends of the local orchestrator: `InProcess` runs commands in the calling thread, pool.py in workers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import ExitStack
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core import BuildEnvironment, Failure, Signature
from .executor import FAILURES, Executor, as_karolos_error
from .shared_memory import EnvironmentArrays

Ids = NDArray[np.int64]


class Group(NamedTuple):
    """Environments with the same command: distinct ids, and the index of their rows in an array."""

    ids: Ids
    rows: slice | Ids
    """A slice if the ids are consecutive, because NumPy indexes faster with slices."""

    @classmethod
    def of(cls, environments: Sequence[int] | Ids) -> Group:
        ids = np.array(environments, np.int64)
        consecutive = ids.size > 0 and bool((np.diff(ids) == 1).all())
        return cls(ids, slice(int(ids[0]), int(ids[-1]) + 1) if consecutive else ids)


class Backend(ABC):
    """Runs commands on environments 0 .. n - 1. Inputs and results are in `arrays`."""

    signature: Signature
    arrays: EnvironmentArrays

    @abstractmethod
    def send(self, command: bytes, environments: Group) -> None:
        """Start a command on idle environments. Does not wait and does not raise."""

    @abstractmethod
    def collect(self, *, wait: bool = True) -> tuple[list[Group], list[Failure]]:
        """The environments that have completed their commands since the last call, and those that failed.

        With `wait`, blocks for a limited time until there are some; both may be empty.
        """

    @abstractmethod
    def close(self) -> None: ...


class InProcess(Backend):
    """Runs all environments in this process; `collect` runs the commands."""

    def __init__(self, build: BuildEnvironment, size: int) -> None:
        with ExitStack() as stack:
            try:
                self._executor = Executor(build, size, stack)
            except FAILURES as error:
                raise as_karolos_error(error, "building an environment") from error
            self._open = stack.pop_all()
        self.signature = self._executor.signature
        self.arrays = EnvironmentArrays.private(self.signature, size)
        self._executor.attach(self.arrays, 0)
        self._commands: list[tuple[bytes, Group]] = []

    def send(self, command: bytes, environments: Group) -> None:
        self._commands.append((command, environments))

    def collect(self, *, wait: bool = True) -> tuple[list[Group], list[Failure]]:  # noqa: ARG002 (runs at once)
        commands = [(index, command) for command, group in self._commands for index in group.ids.tolist()]
        self._commands.clear()
        done, failures = [], []
        for index, command in commands:
            try:
                self._executor.run(command, index)
                done.append(index)
            except FAILURES as error:
                failures.append(Failure(np.array([index]), as_karolos_error(error, f"environment {index}")))
        return [Group.of(done)], failures

    def close(self) -> None:
        self._open.close()
