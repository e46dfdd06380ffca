"""The interface of orchestrators and their results."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import KarolosError
from .environment import Environment
from .experience import Step
from .signature import FloatArray, Signature

BuildEnvironment = Callable[[], Environment]
"""Builds one of an orchestrator's environments, which are all alike. Picklable, so that workers can call it."""


class Failure(NamedTuple):
    """An environment that raised, or a worker that ended or hangs: these environments lost their episodes."""

    environment: NDArray[np.int64]
    error: KarolosError
    lost: bool = False
    """Whether the worker ended by itself or was killed, so that the same episode may succeed in another one."""


class Received(NamedTuple):
    """The environments that answered, in ascending order, and their steps."""

    environment: NDArray[np.int64]
    step: Step
    updates: NDArray[np.int64]
    """The argument `updates` of each environment's `Orchestrator.step`, to compute the policy lag; -1 after a reset."""
    failures: tuple[Failure, ...] = ()

    @property
    def failed(self) -> NDArray[np.int64]:
        """The environments that lost their episodes, in ascending order."""
        return environments_of(self.failures)

    def select(self, which: NDArray[np.bool_]) -> Received:
        """The answers selected by a mask (n,), without failures."""
        if which.all():
            return self._replace(failures=())
        return Received(self.environment[which], self.step.select(which), self.updates[which])


def environments_of(failures: Sequence[Failure]) -> NDArray[np.int64]:
    """The environments of these failures, in ascending order."""
    return np.unique(np.concatenate([np.zeros(0, np.int64), *(failure.environment for failure in failures)]))


class Orchestrator(ABC):
    """Many environments with ids 0 .. size - 1, each with at most one pending command.

    Commands. `reset` and `step` start a command and return; `receive` returns the results. Ids are distinct, and their
    environments have no pending command. All three raise ValueError after `close`.

    Determinism. The results of an environment depend only on its seeds and actions, not on the layout or on timing.

    Failures. An environment that raises, or whose worker ends or hangs, loses its episode, whether it is busy or idle.
    The next `receive` lists it in `failed` with the cause in `failures`, and returns no step of it. The environment is
    then idle. Its next reset builds it again, with a new worker if necessary, and may fail like any command. A loop in
    lockstep plays the episodes of a lost worker again, with their seeds and actions. It cuts other lost episodes in its
    buffer (`buffer.cut(received.failed)`), drops their counts and resets these environments with new seeds. `receive`
    raises the error of an environment that fails repeatedly.
    """

    signature: Signature
    """The signature of every environment."""
    size: int
    """Number of environments."""
    library: ClassVar[str | None] = None
    """A module that must be installed, and the extra of karolos that installs it."""

    @abstractmethod
    def reset(self, environments: Sequence[int] | NDArray[np.int64], seeds: Sequence[int]) -> None:
        """Begin an episode in each of these environments, with its seed. Does not wait."""

    @abstractmethod
    def step(self, environments: Sequence[int] | NDArray[np.int64], actions: FloatArray, *, updates: int = 0) -> None:
        """Step each of these environments with its row of actions (n, a), or (n, 1) for indices. Does not wait.

        `updates` is the number of gradient updates of the policy that chose the actions; `receive` returns it.
        """

    @abstractmethod
    def receive(self, at_least: int | None = None) -> Received:
        """Wait for all pending commands (lockstep), or until `at_least` environments answered or failed (async).

        Returns all answers so far; `at_least` = 0 does not wait. The arrays belong to the caller.
        """

    @abstractmethod
    def parameters(self, environments: Sequence[int] | NDArray[np.int64]) -> FloatArray:
        """The values that domain randomization sampled for the running episodes: (n, signature.parameters.size)."""

    @abstractmethod
    def measures(self, environments: Sequence[int] | NDArray[np.int64]) -> FloatArray:
        """The measures of the episodes that these environments ended last: (n, signature.measures)."""

    def describe(self) -> dict[str, Any]:
        """The layout of the environments over the machine, as JSON-able data for the run's record."""
        return {}

    @abstractmethod
    def close(self) -> None:
        """End the workers and free shared memory. Safe to call twice."""

    def __enter__(self) -> Orchestrator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
