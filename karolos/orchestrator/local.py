"""The orchestrator of one machine: environments over processes and threads."""

from __future__ import annotations

import atexit
import itertools
import operator
import weakref
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Setting

from ..core import FloatArray, Orchestrator, Received, Step
from ..core import Settings as BaseSettings
from ..environments.build import build_environment
from ..errors import RunError
from .commands import RESET, STEP, Build
from .crew import Crew, Ids, Serial
from .workers import Workers

if TYPE_CHECKING:
    from ..spec.recipe import Recipe

Named = Sequence[int] | NDArray[np.int64]


class Local(Orchestrator):
    """Environments on this machine, over `processes` x `threads` x `environments` (per thread).

    Processes are what makes physics faster: PyBullet holds Python's interpreter lock while it steps, so that threads
    take turns. Threads pay for environments that release the lock: those that wait for a device, a socket or another
    program, and simulators that release it while they compute. With `processes: 0` all environments are stepped by the
    calling thread when it receives, one after the other, which is what a debugger wants.

    What an environment does depends on its seeds and actions alone, so the layout changes no result.

    A command that fails raises from `receive`, once per failure, as the KarolosError that the environment raised or as
    a WorkerError with the traceback. The failed environment is idle and has no episode then; a reset gives it one,
    unless its worker is dead. Other environments' answers are kept for the next `receive`.
    """

    class Settings(BaseSettings):
        processes: int = Setting(1, ge=0, le=1024, description="worker processes; 0: step in the main process")
        threads: int = Setting(
            1, ge=1, le=1024, description="threads per process; for environments that wait for things"
        )
        environments: int = Setting(8, ge=1, le=65536, description="environments per thread")

        @property
        def size(self) -> int:
            """Environments in all."""
            return max(self.processes, 1) * self.threads * self.environments

        def identity(self) -> dict[str, Any]:
            """What results depend on: how many episodes run side by side, not where."""
            return {"environments": self.size}

    def __init__(
        self, settings: Local.Settings, recipe: Recipe, *, size: int | None = None, build: Build = build_environment
    ) -> None:
        """Start the workers and wait until every environment is built.

        Args:
            settings: the layout.
            recipe: what to build, once per environment. Picklable.
            size: how many environments, if not as many as the layout names; spread evenly over it.
            build: makes an environment from the recipe. Picklable.

        Raises:
            KarolosError: an environment cannot be built; the error is the environment's own where it is one.
            MachineError: the machine gives no more processes.
        """
        self.size = settings.size if size is None else size
        if self.size < 1:
            raise ValueError(f"an orchestrator needs at least one environment, not {self.size}")
        self._crew: Crew | None
        if settings.processes:
            self._crew = Workers(build, recipe, _layout(self.size, settings.processes, settings.threads))
        else:
            self._crew = Serial(build, recipe, self.size)
        # Before the interpreter waits for its child processes at exit, and when nobody refers to this any more.
        self._close = weakref.finalize(self, self._crew.close)
        atexit.register(self._close)
        self.signature = self._crew.signature
        self._busy = np.zeros(self.size, np.bool_)
        self._answered = np.zeros(self.size, np.bool_)

    def reset(self, environments: Named, seeds: Sequence[int]) -> None:
        """Begin an episode in each environment named, with the seed (0 .. 2**64 - 1) beside it. Does not wait.

        Raises ValueError for unknown or repeated ids, ids with a command under way, and seeds that are none.
        """
        crew, ids = self._check(environments)
        if len(seeds) != ids.size:
            raise ValueError(f"{ids.size} environments need {ids.size} seeds, not {len(seeds)}")
        try:
            numbers = np.array([operator.index(seed) for seed in seeds], np.uint64)
        except OverflowError:
            raise ValueError(f"a seed lies in 0 .. 2**64 - 1; these do not: {list(seeds)}") from None
        crew.block.seed[ids] = numbers
        self._send(crew, RESET, ids)

    def step(self, environments: Named, actions: FloatArray) -> None:
        """Hand each environment named its row of `actions` (n, action.size). Does not wait.

        Raises ValueError for ids as `reset` does and for another shape, RunError for an action that is not finite.
        """
        crew, ids = self._check(environments)
        shape = (ids.size, self.signature.action.size)
        if np.shape(actions) != shape:
            raise ValueError(f"{ids.size} environments take actions of shape {shape}, not {np.shape(actions)}")
        if not np.isfinite(actions).all():
            raise RunError(
                "the agent gave an action that is not a finite number",
                where=f"environment {ids[~np.isfinite(actions).all(axis=1)][0]}",
                hint="learning has diverged: lower the learning rate, or look at what the environment observes",
            )
        crew.block.action[ids] = actions
        self._send(crew, STEP, ids)

    def receive(self) -> Received:
        """Wait for all commands under way; nothing under way gives nothing. The arrays are the caller's to keep.

        Raises the error of a command that failed as soon as it is known; see the class. An interrupt while it waits
        (KeyboardInterrupt) closes the orchestrator.
        """
        crew = self._running()
        while self._busy.any():
            try:
                answers = crew.collect()
            except BaseException:  # an interrupt has torn a message or a step; what comes next could not be trusted
                self.close()
                raise
            self._busy[answers.done] = False
            self._busy[answers.failed] = False
            self._answered[answers.done] = True
            if answers.error is not None:
                raise answers.error
        ids = np.flatnonzero(self._answered)
        self._answered[:] = False
        block = crew.block
        return Received(
            ids,
            Step(
                block.observation[ids],
                block.achieved_goal[ids],
                block.desired_goal[ids],
                block.reward[ids],
                block.terminated[ids],
                block.truncated[ids],
                block.success[ids],
                block.diverged[ids],
            ),
        )

    def parameters(self, environments: Named) -> FloatArray:
        """What domain randomization drew for the running episodes: (n, signature.parameters.size)."""
        crew, ids = self._check(environments)
        return crew.block.parameters[ids]

    def close(self) -> None:
        """End workers and free shared memory; commands under way are given up. Safe to call twice."""
        self._crew = None
        self._close()
        atexit.unregister(self._close)

    def _running(self) -> Crew:
        if self._crew is None:
            raise ValueError("this orchestrator is closed")
        return self._crew

    def _check(self, environments: Named) -> tuple[Crew, Ids]:
        """The ids as an array. Raises ValueError unless they are known, distinct and idle."""
        crew = self._running()
        named = np.asarray(environments)
        if not named.size:
            return crew, np.zeros(0, np.int64)
        if named.ndim != 1 or named.dtype.kind not in "iu":
            raise ValueError(f"environments are named by a list of ids, not by {named.dtype} of shape {named.shape}")
        ids = named.astype(np.int64)
        if ids.min() < 0 or ids.max() >= self.size:
            raise ValueError(f"environments are numbered 0 to {self.size - 1}; there is no {_first(ids, self.size)}")
        if self._busy[ids].any():
            raise ValueError(f"environment {ids[self._busy[ids]][0]} has a command under way; receive its answer first")
        if ids.size > 1 and not (ids[1:] > ids[:-1]).all() and np.unique(ids).size < ids.size:
            raise ValueError(f"an environment takes one command at a time; named twice among {ids.tolist()}")
        return crew, ids

    def _send(self, crew: Crew, command: bytes, ids: Ids) -> None:
        if ids.size:
            self._busy[ids] = True
            self._answered[ids] = False  # an answer that nobody fetched is overwritten now
            crew.send(command, ids)


def _first(ids: Ids, size: int) -> int:
    return int(ids[(ids < 0) | (ids >= size)][0])


def _layout(size: int, processes: int, threads: int) -> tuple[tuple[range, ...], ...]:
    """Ids 0 .. size - 1 over processes, and each process's over its threads: even, in order, nobody without one."""
    return tuple(tuple(_split(ids, threads)) for ids in _split(range(size), processes))


def _split(ids: range, parts: int) -> list[range]:
    parts = min(parts, len(ids))
    bounds = [ids.start + len(ids) * part // parts for part in range(parts + 1)]
    return [range(start, stop) for start, stop in itertools.pairwise(bounds)]
