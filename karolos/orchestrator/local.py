"""The local orchestrator: environments over processes and threads of this machine."""

from __future__ import annotations

import atexit
import math
import operator
import weakref
from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting
from pydantic import model_validator

from ..core import BuildEnvironment, Failure, FloatArray, Orchestrator, Received, Step
from ..core import Settings as BaseSettings
from ..core.orchestrator import environments_of
from ..errors import RunError
from .executor import RESET, STEP, Group, InProcess
from .pool import WorkerPool
from .processes import ProcessPool

EnvironmentIds = Sequence[int] | NDArray[np.int64]
Backend = InProcess | WorkerPool

MAX_ENVIRONMENTS = 65_536


class Limits(BaseSettings):
    """Settings for failures of environments and workers."""

    time_limit: float = Setting(
        default=60.0,
        gt=0,
        description="largest time of one reset or step in seconds; after it the worker is killed and replaced. No "
        "limit with `processes: 0`",
    )
    failures: int = Setting(
        default=5,
        ge=0,
        description="largest number of consecutive failures of an environment (an error or a lost worker) that are "
        "replaced; one more ends the run. A completed episode resets the count",
    )


class Local(Orchestrator):
    """Environments on this machine: `processes` x `threads` x `environments` (per thread).

    Use processes to speed up physics: PyBullet holds Python's interpreter lock while it steps, so threads take turns.
    Use threads for environments that release the lock because they wait for a device, a socket or another program.
    With `processes: 0` the calling thread steps all environments in `receive`, one after the other, for debugging.

    An environment depends only on its seeds and actions, so the layout does not change results.

    `receive` raises the error of an environment that fails more than `failures` times without a completed episode in
    between: its KarolosError, or a WorkerError with the traceback. The environment is then idle and can be reset. The
    next `receive` returns the answers and failures of the other environments.
    """

    class Settings(Limits):
        processes: int = Setting(default=1, ge=0, le=1024, description="worker processes; 0: step in the main process")
        threads: int = Setting(
            default=1, ge=1, le=1024, description="threads per process, for environments that wait for I/O"
        )
        environments: int = Setting(default=8, ge=1, le=MAX_ENVIRONMENTS, description="environments per thread")

        @model_validator(mode="after")
        def _not_too_many(self) -> Self:
            if self.size > MAX_ENVIRONMENTS:
                raise ValueError(
                    f"processes x threads x environments are {self.size} environments; {MAX_ENVIRONMENTS} are allowed"
                )
            return self

        @property
        def size(self) -> int:
            """Number of environments."""
            return max(self.processes, 1) * self.threads * self.environments

        def identity(self) -> dict[str, Any]:
            """The settings that change results: the number of environments, not their layout."""
            return {"environments": self.size}

    def __init__(self, settings: Local.Settings, build: BuildEnvironment) -> None:
        """Start the workers and wait until every environment is built.

        Raises:
            KarolosError: an environment cannot be built.
            MachineError: the machine cannot start the processes.
        """
        self.size = settings.size
        self._settings = settings
        backend = self._start(build)
        self._backend: Backend | None = backend
        # Close when this object is collected, and at exit before the interpreter waits for its child processes.
        self._close = weakref.finalize(self, backend.close)
        atexit.register(self._close)
        self.signature = backend.signature
        self._action_size = self.signature.action.size
        self._busy = np.zeros(self.size, np.bool_)
        self._answered = np.zeros(self.size, np.bool_)
        self._updates = np.full(self.size, -1)
        self._failed = np.zeros(self.size, np.int64)
        """Failures of each environment since its last completed episode."""
        self._any_failed = False
        self._failures: list[Failure] = []
        """Those that no `receive` has returned or raised yet."""
        self._pending = self._ready = 0
        self._all_ids = np.arange(self.size)

    def _start(self, build: BuildEnvironment) -> Backend:
        """Start the workers."""
        settings = self._settings
        if not settings.processes:
            return InProcess(build, self.size)
        return ProcessPool(build, self._layout(), settings.time_limit, settings.failures)

    def _layout(self) -> list[list[range]]:
        """The ids of each channel's environments, by process: one channel for each thread."""
        threads, environments = self._settings.threads, self._settings.environments
        ids = [range(first, first + environments) for first in range(0, self.size, environments)]
        return [ids[first : first + threads] for first in range(0, len(ids), threads)]

    def reset(self, environments: EnvironmentIds, seeds: Sequence[int]) -> None:
        """As `Orchestrator.reset`, with seeds in 0 .. 2**64 - 1."""
        backend, group = self._running(), Group.of(environments)
        backend.arrays.seed[group.rows] = np.array([operator.index(seed) for seed in seeds], np.uint64)
        self._send(backend, RESET, group, -1)

    def step(self, environments: EnvironmentIds, actions: FloatArray, *, updates: int = 0) -> None:
        """As `Orchestrator.step`. Raises ValueError for another shape, RunError for an action that is not finite."""
        backend, group = self._running(), Group.of(environments)
        ids = group.ids
        shape = (ids.size, self._action_size)
        if actions.shape != shape:
            raise ValueError(f"{ids.size} environments take actions of shape {shape}, not {actions.shape}")
        if not math.isfinite(actions.sum()) and not np.isfinite(actions).all():  # the sum is faster, but may overflow
            raise RunError(
                "the agent gave an action that is not a finite number",
                where=f"environment {ids[~np.isfinite(actions).all(axis=1)][0]}",
                hint="learning has diverged: lower the learning rate, or check the observations",
            )
        backend.arrays.action[group.rows] = actions
        self._send(backend, STEP, group, updates)

    def receive(self, at_least: int | None = None) -> Received:
        """As `Orchestrator.receive`; empty without pending commands.

        Raises the error of an environment that failed too often; see the class. A KeyboardInterrupt while waiting
        closes the orchestrator.
        """
        backend = self._running()
        self._raise_repeated()
        while self._pending and (at_least is None or at_least > self._ready + environments_of(self._failures).size):
            self._collect(backend, wait=True)
        if at_least == 0 and self._pending:
            self._collect(backend, wait=False)
        failures, self._failures = tuple(self._failures), []
        return self._fetch(backend, failures)

    def _collect(self, backend: Backend, *, wait: bool) -> None:
        """Record the answers of the backend. Raises the error of the first environment that failed too often."""
        try:
            done, failures = backend.collect(wait=wait)
        except BaseException:  # an interrupt may have cut a message or a step short
            self.close()
            raise
        for ids, rows in done:
            self._busy[rows] = False
            self._answered[rows] = True
            self._pending -= ids.size
            self._ready += ids.size
        for ids, *_ in failures:
            self._pending -= int(self._busy[ids].sum())
            self._ready -= int(self._answered[ids].sum())
            self._busy[ids] = self._answered[ids] = False
            self._failed[ids] += 1
            self._any_failed = True
        self._failures += failures
        self._raise_repeated()

    def _raise_repeated(self) -> None:
        for place, failure in enumerate(self._failures):
            if (self._failed[failure.environment] > self._settings.failures).any():
                del self._failures[place]
                raise failure.error

    def _fetch(self, backend: Backend, failures: tuple[Failure, ...]) -> Received:
        """The answers that no `receive` has returned yet."""
        all_ready = self._ready == self.size
        ids = self._all_ids.copy() if all_ready else np.flatnonzero(self._answered)
        self._answered[:] = False
        self._ready = 0

        def rows(array: NDArray[Any]) -> NDArray[Any]:
            return array.copy() if all_ready else array[ids]

        step = Step(*map(rows, backend.arrays.step))
        if self._any_failed:
            self._failed[ids[step.terminated | step.truncated]] = 0
        return Received(ids, step, rows(self._updates), failures)

    def parameters(self, environments: EnvironmentIds) -> FloatArray:
        return self._running().arrays.parameters[np.asarray(environments, np.int64)]

    def measures(self, environments: EnvironmentIds) -> FloatArray:
        return self._running().arrays.measures[np.asarray(environments, np.int64)]

    def describe(self) -> dict[str, Any]:
        settings = self._settings
        return {"processes": settings.processes, "threads": settings.threads, "environments": self.size}

    def close(self) -> None:
        self._backend = None
        self._close()
        atexit.unregister(self._close)

    def _running(self) -> Backend:
        if self._backend is None:
            raise ValueError("this orchestrator is closed")
        return self._backend

    def _send(self, backend: Backend, command: bytes, group: Group, updates: int) -> None:
        if group.ids.size:
            if self._ready:  # the command overwrites an answer that was not received
                self._ready -= int(self._answered[group.rows].sum())
                self._answered[group.rows] = False
            if self._failures:  # or a failure
                rest = [(np.setdiff1d(one.environment, group.ids), one) for one in self._failures]
                self._failures = [one._replace(environment=ids) for ids, one in rest if ids.size]
            self._busy[group.rows] = True
            self._updates[group.rows] = updates
            self._pending += group.ids.size
            backend.send(command, group)
