"""What is done to one environment on command, the same in a worker process and in the parent's own."""

from __future__ import annotations

import pickle
import traceback
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np

from ..core import Discrete, Environment, Signature, Step
from ..errors import KarolosError, PluginError, WorkerError
from .block import Block

Build = Callable[[Any], Environment]
"""Makes an environment from a recipe; picklable, so a function of a module."""

RESET = b"r"
STEP = b"s"
"""Commands, as the first byte of a message. What they need stands in the block, in the environment's row."""

FAILURES = (Exception, SystemExit)
"""What a plugin's code may raise: all of it is reported, because a worker that ends in silence helps nobody."""


class Executor:
    """Builds environments of one recipe, and runs commands on them between their rows of a block.

    An environment that has raised may be in any state: its next reset builds it anew.

    Args:
        stack: closes the environments, also those built before one failed.
    """

    def __init__(self, build: Build, recipe: Any, count: int, stack: ExitStack) -> None:
        self._build = build
        self._recipe = recipe
        self._environments: list[Environment] = []
        self._broken: set[int] = set()
        stack.callback(self._close)
        for _ in range(count):
            self._environments.append(build(recipe))
        self.signature: Signature = self._environments[0].signature
        self._discrete = isinstance(self.signature.action, Discrete)

    def attach(self, block: Block, first: int) -> None:
        """Take commands from `block` for the environments, whose ids begin at `first`."""
        self._block = block
        self._first = first

    def run(self, command: bytes, index: int) -> None:
        """Carry out `command` on the environment with the id `index`. Raises whatever the environment raises."""
        try:
            if command == RESET:
                self._reset(index)
            else:
                self._step(index)
        except FAILURES:
            self._broken.add(index)
            raise
        finally:
            self._block.commands[index] += 1

    def _close(self) -> None:
        for environment in self._environments:
            environment.close()

    def _reset(self, index: int) -> None:
        place = index - self._first
        if index in self._broken:
            self._environments[place].close()
            self._environments[place] = self._build(self._recipe)
            self._broken.remove(index)
        environment = self._environments[place]
        step = environment.reset(int(self._block.seed[index]))
        _check_shapes(environment, step)
        self._write(index, step)
        if self.signature.parameters.size:
            self._block.parameters[index] = environment.parameters()

    def _step(self, index: int) -> None:
        row = self._block.action[index]
        # A copy: an environment may keep its last actions (an action delay does), and the row is overwritten.
        action = int(row[0]) if self._discrete else row.copy()
        self._write(index, self._environments[index - self._first].step(np.asarray(action)))

    def _write(self, index: int, step: Step) -> None:
        block = self._block
        (
            block.observation[index],
            block.achieved_goal[index],
            block.desired_goal[index],
            block.reward[index],
            block.terminated[index],
            block.truncated[index],
            block.success[index],
            block.diverged[index],
        ) = step


def _check_shapes(environment: Environment, step: Step) -> None:
    """Refuse what NumPy would stretch to fit; once per episode is enough, a wrong plugin is wrong from the start."""
    signature = environment.signature
    for what, array, layout in (
        ("observation", step.observation, signature.observation),
        ("achieved goal", step.achieved_goal, signature.achieved_goal),
        ("desired goal", step.desired_goal, signature.desired_goal),
        ("parameters", environment.parameters(), signature.parameters),
    ):
        if np.shape(array) != (layout.size,):
            raise PluginError(
                f"{type(environment).__name__} gives {what} of shape {np.shape(array)}, "
                f"its signature says {(layout.size,)}",
                hint="make the environment's signature and its steps agree",
            )


def as_karolos_error(error: BaseException, where: str) -> KarolosError:
    """The error to raise at the parent: itself where it speaks to a person, else a WorkerError with the traceback."""
    if isinstance(error, KarolosError):
        return error
    text = str(error).strip().splitlines()
    return WorkerError(
        f"{type(error).__name__}: {text[0]}" if text else type(error).__name__,
        where=where,
        hint="the traceback shows the line in the environment or plugin that failed",
        traceback="".join(traceback.format_exception(error)),
    )


def pack_errors(errors: list[tuple[int, KarolosError]]) -> bytes:
    """Errors beside the ids of their environments, as bytes for another process."""
    portable = []
    for index, error in errors:
        try:
            pickle.loads(pickle.dumps(error))
            portable.append((index, error))
        except Exception:  # a plugin's own kind of KarolosError may hold anything, and fail in any way
            text = "".join(traceback.format_exception(error))
            portable.append((index, WorkerError(error.what, where=error.where, hint=error.hint, traceback=text)))
    return pickle.dumps(portable)


def unpack_errors(message: bytes) -> list[tuple[int, KarolosError]]:
    """The other end of `pack_errors`."""
    errors: list[tuple[int, KarolosError]] = pickle.loads(message)
    return errors
