"""Execution of commands on environments, in a worker process or in the main process, and the arrays for their data."""

from __future__ import annotations

import pickle
import traceback
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core import BuildEnvironment, Discrete, Environment, Failure, FloatArray, Signature, Step
from ..core.environment import close
from ..errors import KarolosError, PluginError, WorkerError, described
from ..registry import blaming

RESET = b"r"
STEP = b"s"
"""Commands: the first byte of a message. Their arguments are in the environment's row of the arrays."""

ALIGNMENT = 64
"""Each array begins at a multiple of these bytes, so that arrays never share a cache line."""
LARGE = 1e30
"""If the sum of numbers is smaller, all are finite in float32."""
FAILURES = (Exception, SystemExit)
"""Exceptions of plugins that are reported to the parent."""
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


@dataclass(frozen=True)
class EnvironmentArrays:
    """An array per quantity with a row per environment, all in one block of memory: nothing is pickled.

    The parent writes `seed` and `action`, the environments write the other arrays.
    """

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


class Executor:
    """Builds environments and runs commands on them. Reads from and writes to their rows of the arrays.

    The state of an environment that raised is unknown, so its next reset builds it again.

    Args:
        stack: closes the environments, even if one of them cannot be built.
    """

    def __init__(self, build: BuildEnvironment, count: int, stack: ExitStack) -> None:
        self._build = build
        self._environments: list[Environment] = []
        self._broken: set[int] = set()
        self._fresh: set[int] = set()
        """The ids of the environments whose last call was a reset."""
        stack.callback(self._close)
        for _ in range(count):
            self._environments.append(build())
        self.signature: Signature = self._environments[0].signature
        self._discrete = isinstance(self.signature.action, Discrete)

    def attach(self, arrays: EnvironmentArrays, first: int) -> None:
        """Use these arrays; `first` is the id of the first environment."""
        self._arrays = arrays
        self._first = first

    def run(self, command: bytes, index: int) -> None:
        """Run `command` on the environment with the id `index`. Raises what the environment raises."""
        try:
            if command == RESET:
                self._reset(index)
            else:
                self._step(index)
        except BaseException:
            self._broken.add(index)
            raise
        finally:
            self._arrays.commands[index] += 1

    def _close(self) -> None:
        for environment in self._environments:
            close(environment)

    def _reset(self, index: int) -> None:
        position = index - self._first
        if index in self._broken:
            close(self._environments[position])
            self._environments[position] = self._build()
            self._broken.remove(index)
        environment = self._environments[position]
        step = environment.reset(int(self._arrays.seed[index]))
        _check_reset(environment, step)
        self._fresh.add(index)
        self._write(environment, index, step)
        if self.signature.parameters.size:
            self._arrays.parameters[index] = environment.parameters()

    def _step(self, index: int) -> None:
        row = self._arrays.action[index]
        # A copy, because an environment may store its last actions (e.g. an action delay) and the row is overwritten.
        action = int(row[0]) if self._discrete else row.copy()
        environment = self._environments[index - self._first]
        step = environment.step(np.asarray(action))
        if index in self._fresh:
            self._fresh.remove(index)
            _check_shapes(environment, step)
        if not _is_finite(step):  # the episode diverged: it ends with the state before
            before = Step(*(array[index] for array in self._arrays.step))
            step = before._replace(reward=0.0, terminated=False, truncated=True, success=False, diverged=True)
        self._write(environment, index, step)

    def _write(self, environment: Environment, index: int, step: Step) -> None:
        for array, value in zip(self._arrays.step, step, strict=True):
            array[index] = value
        if (step.terminated or step.truncated) and self.signature.measures:
            self._arrays.measures[index] = environment.measures()


class InProcess:
    """Runs all environments in this process, with the methods of a WorkerPool; `collect` runs the commands."""

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


def _is_finite(step: Step) -> bool:
    """Whether all numbers of a step are finite in float32."""
    numbers = [np.asarray(one) for one in step[:4]]
    total = sum(sum(one.tolist()) for one in numbers[:3]) + step.reward
    if abs(total) < LARGE:  # ten times faster than `isfinite`
        return True
    with np.errstate(over="ignore"):
        return all(np.isfinite(one.astype(np.float32)).all() for one in numbers)


def _check_reset(environment: Environment, step: Step) -> None:
    """Raise PluginError for a wrong shape, numbers that are not finite, or an end of the episode without divergence."""
    name, signature = type(environment).__name__, environment.signature
    _check_shapes(environment, step)
    _check_shape(name, "parameters", environment.parameters(), signature.parameters.size)
    if not _is_finite(step):
        hint = "check how the environment computes them"
        raise PluginError(f"{name}.reset returns numbers that are not finite", hint=hint)
    if (step.terminated or step.truncated) and not step.diverged:
        hint = "begin an episode in a state from which it goes on"
        raise PluginError(f"{name}.reset returns a step that ends the episode", hint=hint)


def _check_shapes(environment: Environment, step: Step) -> None:
    """Raise PluginError for a shape that NumPy would broadcast silently."""
    name, signature = type(environment).__name__, environment.signature
    _check_shape(name, "observation", step.observation, signature.observation.size)
    _check_shape(name, "achieved goal", step.achieved_goal, signature.achieved_goal.size)
    _check_shape(name, "desired goal", step.desired_goal, signature.desired_goal.size)


def _check_shape(name: str, part: str, array: ArrayLike, size: int) -> None:
    if (shape := np.shape(array)) != (size,):
        what = f"{name} returns {part} of shape {shape}, its signature says {(size,)}"
        raise PluginError(what, hint="make the environment's signature and its steps agree")


def as_karolos_error(error: BaseException, where: str) -> KarolosError:
    """A KarolosError itself; any other error as a WorkerError at the line that failed, with the traceback."""
    if isinstance(error, KarolosError):
        return error
    text, plugin = "".join(traceback.format_exception(error)), None
    frame = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{frame.filename}:{frame.lineno}"
    try:
        with blaming():
            raise error
    except PluginError as found:
        place, plugin = str(found.where), found.plugin
    except BaseException:  # not of a plugin
        pass
    hint = "free memory, or use fewer environments" if isinstance(error, MemoryError) else None
    return WorkerError(described(error), where=f"{where}: {place}", plugin=plugin, hint=hint, traceback=text)


def pack_errors(errors: list[tuple[int, KarolosError]]) -> bytes:
    """Pickle pairs of environment id and error for another process."""
    portable = []
    for index, error in errors:
        sent = error
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:  # a plugin's subclass of KarolosError may fail to pickle in any way
            place = {"where": error.where, "setting": error.setting, "hint": error.hint}
            sent = WorkerError(error.what, traceback="".join(traceback.format_exception(error)), **place)
        portable.append((index, sent))
    return pickle.dumps(portable)
