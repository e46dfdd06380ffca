"""The orchestrator of one machine: environments over processes and threads."""

from __future__ import annotations

import atexit
import itertools
import math
import operator
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting

from ..core import Failure, FloatArray, Orchestrator, Received, Step
from ..core import Settings as BaseSettings
from ..environments.build import build_environment
from ..errors import RunError
from .commands import RESET, STEP, Build
from .crew import Crew, Group, Ids, Serial
from .workers import Workers

Named = Sequence[int] | NDArray[np.int64]


class Limits(BaseSettings):
    """What is borne from environments and workers before a run gives up."""

    time_limit: float = Setting(
        default=60.0,
        gt=0,
        description="seconds that one reset or step may take before its worker is killed and replaced; "
        "nothing watches over `processes: 0`",
    )
    failures: int = Setting(
        default=5,
        ge=0,
        description="how often an environment may fail (raise, or lose its worker) without an episode that ends "
        "in between; what fails is replaced, one time more ends the run",
    )


class Local(Orchestrator):
    """Environments on this machine, over `processes` x `threads` x `environments` (per thread).

    Processes are what makes physics faster: PyBullet holds Python's interpreter lock while it steps, so that threads
    take turns. Threads pay for environments that release the lock: those that wait for a device, a socket or another
    program, and simulators that release it while they compute. With `processes: 0` all environments are stepped by the
    calling thread when it receives, one after the other, which is what a debugger wants.

    What an environment does depends on its seeds and actions alone, so the layout changes no result.

    An environment that fails more than `failures` times without an episode that ends in between raises its error from
    `receive`: the KarolosError that it raised, or a WorkerError with the traceback. It is idle then and has no episode;
    a reset gives it one. Other environments' answers are kept for the next `receive`.
    """

    class Settings(Limits):
        processes: int = Setting(default=1, ge=0, le=1024, description="worker processes; 0: step in the main process")
        threads: int = Setting(
            default=1, ge=1, le=1024, description="threads per process; for environments that wait for things"
        )
        environments: int = Setting(default=8, ge=1, le=65536, description="environments per thread")

        @property
        def size(self) -> int:
            """Environments in all."""
            return max(self.processes, 1) * self.threads * self.environments

        def identity(self) -> dict[str, Any]:
            """What results depend on: how many episodes run side by side, not where."""
            return {"environments": self.size}

    def __init__(
        self, settings: Local.Settings, recipe: Any, *, size: int | None = None, build: Build = build_environment
    ) -> None:
        """Start the workers and wait until every environment is built.

        Args:
            settings: the layout.
            recipe: what to build, once per environment: whatever `build` takes. Picklable.
            size: how many environments, if not as many as the layout names; spread evenly over it.
            build: makes an environment from the recipe. Picklable.

        Raises:
            KarolosError: an environment cannot be built; the error is the environment's own where it is one.
            MachineError: the machine gives no more processes.
        """
        self.size = settings.size if size is None else size
        if self.size < 1:
            raise ValueError(f"an orchestrator needs at least one environment, not {self.size}")
        self._layout = _layout(self.size, settings.processes or 1, settings.threads)
        self._settings = settings
        self._crew: Crew | None
        if settings.processes:
            self._crew = Workers(build, recipe, self._layout, settings.time_limit)
        else:
            self._crew = Serial(build, recipe, self.size)
        # Before the interpreter waits for its child processes at exit, and when nobody refers to this any more.
        self._close = weakref.finalize(self, self._crew.close)
        atexit.register(self._close)
        self.signature = self._crew.signature
        self._action_size = self.signature.action.size
        self._busy = np.zeros(self.size, np.bool_)
        self._answered = np.zeros(self.size, np.bool_)
        self._updates = np.full(self.size, -1)
        self._failed = np.zeros(self.size, np.int64)
        """How often each environment has failed since an episode of it ended."""
        self._any_failed = False
        self._under_way = self._ready = 0
        self._known: dict[bytes, Group] = {}
        self._everything = np.arange(self.size)

    def reset(self, environments: Named, seeds: Sequence[int]) -> None:
        """Begin an episode in each environment named, with the seed (0 .. 2**64 - 1) beside it. Does not wait.

        Raises ValueError for unknown or repeated ids, ids with a command under way, and seeds that are none.
        """
        crew, group = self._check(environments)
        if len(seeds) != group.ids.size:
            raise ValueError(f"{group.ids.size} environments need {group.ids.size} seeds, not {len(seeds)}")
        try:
            numbers = np.array([operator.index(seed) for seed in seeds], np.uint64)
        except OverflowError:
            raise ValueError(f"a seed lies in 0 .. 2**64 - 1; these do not: {list(seeds)}") from None
        crew.block.seed[group.rows] = numbers
        self._send(crew, RESET, group, -1)

    def step(self, environments: Named, actions: FloatArray, *, updates: int = 0) -> None:
        """Hand each environment named its row of `actions` (n, action.size). Does not wait.

        Raises ValueError for ids as `reset` does and for another shape, RunError for an action that is not finite.
        """
        crew, group = self._check(environments)
        ids = group.ids
        shape = (ids.size, self._action_size)
        if actions.shape != shape:
            raise ValueError(f"{ids.size} environments take actions of shape {shape}, not {actions.shape}")
        if not math.isfinite(actions.sum()) and not np.isfinite(actions).all():  # a sum costs less, and may overflow
            raise RunError(
                "the agent gave an action that is not a finite number",
                where=f"environment {ids[~np.isfinite(actions).all(axis=1)][0]}",
                hint="learning has diverged: lower the learning rate, or look at what the environment observes",
            )
        crew.block.action[group.rows] = actions
        self._send(crew, STEP, group, updates)

    def receive(self, at_least: int | None = None) -> Received:
        """Wait for all commands under way, or until `at_least` environments have answered or failed.

        Nothing under way gives nothing. The arrays are the caller's to keep. Raises the error of an environment that
        has failed once too often; see the class. An interrupt while it waits (KeyboardInterrupt) closes the
        orchestrator.
        """
        crew = self._running()
        failures: list[Failure] = []
        lost = 0
        asked = at_least is None or at_least > self._ready
        while self._under_way and (at_least is None or asked):
            failures += self._collect(crew, wait=True)
            lost = sum(failure.environment.size for failure in failures)
            asked = at_least is None or at_least > self._ready + lost
        if at_least == 0 and self._under_way:
            failures += self._collect(crew, wait=False)
        return self._fetch(crew, tuple(failures))

    def _collect(self, crew: Crew, *, wait: bool) -> list[Failure]:
        """Take note of what has ended. Raises the error of the first environment that has failed too often."""
        try:
            answers = crew.collect(wait=wait)
        except BaseException:  # an interrupt has torn a message or a step; what comes next could not be trusted
            self.close()
            raise
        for ids, rows in answers.done:
            self._busy[rows] = False
            self._answered[rows] = True
            self._under_way -= ids.size
            self._ready += ids.size
        if not answers.failures:
            return answers.failures
        for ids, _ in answers.failures:
            self._under_way -= int(self._busy[ids].sum())
            self._ready -= int(self._answered[ids].sum())
            self._busy[ids] = self._answered[ids] = False
            self._failed[ids] += 1
            self._any_failed = True
        for ids, error in answers.failures:
            if (self._failed[ids] > self._settings.failures).any():
                raise error
        return answers.failures

    def _fetch(self, crew: Crew, failures: tuple[Failure, ...]) -> Received:
        """What has answered and nobody has had yet."""
        block = crew.block
        everything = self._ready == self.size
        ids = self._everything.copy() if everything else np.flatnonzero(self._answered)
        self._answered[:] = False
        self._ready = 0

        def taken(array: NDArray[Any]) -> NDArray[Any]:
            return array.copy() if everything else array[ids]

        terminated, truncated = taken(block.terminated), taken(block.truncated)
        if self._any_failed:
            self._failed[ids[terminated | truncated]] = 0
        step = Step(
            taken(block.observation),
            taken(block.achieved_goal),
            taken(block.desired_goal),
            taken(block.reward),
            terminated,
            truncated,
            taken(block.success),
            taken(block.diverged),
        )
        return Received(ids, step, taken(self._updates), failures)

    def parameters(self, environments: Named) -> FloatArray:
        """What domain randomization drew for the running episodes: (n, signature.parameters.size)."""
        crew, group = self._check(environments)
        return crew.block.parameters[group.ids]

    def describe(self) -> dict[str, Any]:
        """The layout as it is: fewer processes or threads than asked for where there are not enough environments."""
        processes = len(self._layout) if self._settings.processes else 0
        return {"processes": processes, "threads": max(map(len, self._layout)), "environments": self.size}

    def close(self) -> None:
        """End workers and free shared memory; commands under way are given up. Safe to call twice."""
        self._crew = None
        self._close()
        atexit.unregister(self._close)

    def _running(self) -> Crew:
        if self._crew is None:
            raise ValueError("this orchestrator is closed")
        return self._crew

    def _check(self, environments: Named) -> tuple[Crew, Group]:
        """The environments, as a group. Raises ValueError unless they are known, distinct and idle.

        What was checked once is known by its bytes: the same few sets come again and again.
        """
        crew = self._running()
        key = b""
        if isinstance(environments, np.ndarray) and environments.dtype == np.int64 and environments.ndim == 1:
            key = environments.tobytes()
        group = self._known.get(key)
        if group is None:
            group = Group.of(self._ids(environments))
            if len(self._known) >= 64:
                self._known.clear()
            if key:
                self._known[key] = group
        if self._under_way and self._busy[group.rows].any():
            busy = group.ids[self._busy[group.ids]][0]
            raise ValueError(f"environment {busy} has a command under way; receive its answer first")
        return crew, group

    def _ids(self, environments: Named) -> Ids:
        named = np.asarray(environments)
        if not named.size:
            return np.zeros(0, np.int64)
        if named.ndim != 1 or named.dtype.kind not in "iu":
            raise ValueError(f"environments are named by a list of ids, not by {named.dtype} of shape {named.shape}")
        ids = named.astype(np.int64)
        if ids.min() < 0 or ids.max() >= self.size:
            raise ValueError(f"environments are numbered 0 to {self.size - 1}; there is no {_first(ids, self.size)}")
        if np.unique(ids).size < ids.size:
            raise ValueError(f"an environment takes one command at a time; named twice among {ids.tolist()}")
        return ids

    def _send(self, crew: Crew, command: bytes, group: Group, updates: int) -> None:
        if group.ids.size:
            if self._ready:  # an answer that nobody fetched is overwritten now
                self._ready -= int(self._answered[group.rows].sum())
                self._answered[group.rows] = False
            self._busy[group.rows] = True
            self._updates[group.rows] = updates
            self._under_way += group.ids.size
            crew.send(command, group)


def _first(ids: Ids, size: int) -> int:
    return int(ids[(ids < 0) | (ids >= size)][0])


def _layout(size: int, processes: int, threads: int) -> tuple[tuple[range, ...], ...]:
    """Ids 0 .. size - 1 over processes, and each process's over its threads: even, in order, nobody without one."""
    return tuple(tuple(_split(ids, threads)) for ids in _split(range(size), processes))


def _split(ids: range, parts: int) -> list[range]:
    parts = min(parts, len(ids))
    bounds = [ids.start + len(ids) * part // parts for part in range(parts + 1)]
    return [range(start, stop) for start, stop in itertools.pairwise(bounds)]
