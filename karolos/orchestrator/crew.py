"""Who carries out commands: the calling thread (`Serial`) or worker processes (workers.py). `Local` stands in front."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import ExitStack
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core import Failure, Signature
from .block import Block
from .commands import FAILURES, Build, Executor, as_karolos_error

Ids = NDArray[np.int64]


class Group(NamedTuple):
    """Environments that are told something together: distinct ids, and what picks their rows of an array."""

    ids: Ids
    rows: slice | Ids
    """A slice where the ids are consecutive: NumPy does that faster than a list of places."""

    @classmethod
    def of(cls, ids: Ids) -> Group:
        consecutive = ids.size > 0 and bool((np.diff(ids) == 1).all())
        return cls(ids, slice(int(ids[0]), int(ids[-1]) + 1) if consecutive else ids)


class Answers(NamedTuple):
    """The environments whose commands are done, and the failures, whose environments have no episode any more."""

    done: list[Group]
    failures: list[Failure]


class Crew(ABC):
    """Carries out commands on environments 0 .. n - 1; inputs and results stand in the block."""

    signature: Signature
    block: Block

    @abstractmethod
    def send(self, command: bytes, environments: Group) -> None:
        """Begin a command on idle environments. Does not wait, raises nothing."""

    @abstractmethod
    def collect(self, *, wait: bool = True) -> Answers:
        """What has ended since the last call. Waits for something, but not for ever: it may come with nothing."""

    @abstractmethod
    def close(self) -> None: ...


class Serial(Crew):
    """All environments in this process; commands run when they are collected."""

    def __init__(self, build: Build, recipe: Any, size: int) -> None:
        with ExitStack() as stack:
            try:
                self._executor = Executor(build, recipe, size, stack)
            except FAILURES as error:
                raise as_karolos_error(error, "building an environment") from error
            self._open = stack.pop_all()
        self.signature = self._executor.signature
        self.block = Block.private(self.signature, size)
        self._executor.attach(self.block, 0)
        self._waiting: list[tuple[bytes, Group]] = []

    def send(self, command: bytes, environments: Group) -> None:
        self._waiting.append((command, environments))

    def collect(self, *, wait: bool = True) -> Answers:  # noqa: ARG002 (what is asked for is done at once)
        commands = [(index, command) for command, group in self._waiting for index in group.ids.tolist()]
        self._waiting.clear()
        done, failures = [], []
        for index, command in commands:
            try:
                self._executor.run(command, index)
                done.append(index)
            except FAILURES as error:
                failures.append(Failure(np.array([index]), as_karolos_error(error, f"environment {index}")))
        return Answers([Group.of(np.array(done, np.int64))], failures)

    def close(self) -> None:
        self._open.close()
