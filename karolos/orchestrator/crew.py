"""Who carries out commands: the calling thread (`Serial`) or worker processes (workers.py). `Local` stands in front."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import ExitStack
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core import Signature
from ..errors import KarolosError
from .block import Block
from .commands import FAILURES, Build, Executor, as_karolos_error, build_environments

Ids = NDArray[np.int64]


class Answers(NamedTuple):
    """What came back. `failed` environments have no episode any more; `error` says why the first of them failed."""

    done: Ids
    failed: Ids
    error: KarolosError | None

    @classmethod
    def of(cls, done: list[Ids], errors: list[tuple[int, KarolosError]]) -> Answers:
        """Answers from the ids that are done and the errors beside the ids that are not."""
        errors = sorted(errors, key=lambda entry: entry[0])
        return cls(
            np.concatenate([np.zeros(0, np.int64), *done]),
            np.array([index for index, _ in errors], np.int64),
            errors[0][1] if errors else None,
        )


class Crew(ABC):
    """Carries out commands on environments 0 .. n - 1; inputs and results stand in the block."""

    signature: Signature
    block: Block

    @abstractmethod
    def send(self, command: bytes, environments: Ids) -> None:
        """Begin a command on idle environments. Does not wait, raises nothing."""

    @abstractmethod
    def collect(self) -> Answers:
        """Wait until at least one command under way has ended."""

    @abstractmethod
    def close(self) -> None: ...


class Serial(Crew):
    """All environments in this process; commands run when they are collected."""

    def __init__(self, build: Build, recipe: Any, size: int) -> None:
        with ExitStack() as stack:
            try:
                environments = build_environments(build, recipe, size, stack)
            except FAILURES as error:
                raise as_karolos_error(error, "building an environment") from error
            self._open = stack.pop_all()
        self.signature = environments[0].signature
        self.block = Block.private(self.signature, size)
        self._executor = Executor(environments, self.block, 0)
        self._waiting: list[tuple[bytes, Ids]] = []

    def send(self, command: bytes, environments: Ids) -> None:
        self._waiting.append((command, environments))

    def collect(self) -> Answers:
        commands = [(index, command) for command, ids in self._waiting for index in ids.tolist()]
        self._waiting.clear()
        done, errors = [], []
        for index, command in commands:
            try:
                self._executor.run(command, index)
                done.append(index)
            except FAILURES as error:
                errors.append((index, as_karolos_error(error, f"environment {index}")))
        return Answers.of([np.array(done, np.int64)], errors)

    def close(self) -> None:
        self._open.close()
