"""The interface of orchestrators, and what they give back."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import KarolosError
from .arrays import FloatArray
from .experience import Step
from .signature import Signature


class Failure(NamedTuple):
    """An environment that raised, or a worker that died or hung: these environments have lost their episodes."""

    environment: NDArray[np.int64]
    error: KarolosError


class Received(NamedTuple):
    """What an orchestrator gives back: the environments that answered, in ascending order, and their steps."""

    environment: NDArray[np.int64]
    step: Step
    updates: NDArray[np.int64]
    """The gradient updates behind the policy that chose each action, as `Orchestrator.step` was told; -1 after a
    reset. What has been learned since is the policy lag."""
    failures: tuple[Failure, ...] = ()

    @property
    def failed(self) -> NDArray[np.int64]:
        """The environments that have lost their episodes, in ascending order."""
        return np.unique(np.concatenate([np.zeros(0, np.int64), *(failure.environment for failure in self.failures)]))


class Orchestrator(ABC):
    """Many environments, addressed by id 0 .. size - 1, each with at most one command under way.

    Failure. An environment that raises, or whose worker dies or hangs, loses its episode, whether it was busy or idle.
    The next `receive` names it in `failed`, with the reason in `failures`, and gives no answer of it. It is idle then
    and has no episode before it is reset, which builds it anew, with a new worker where the old one is gone. A loop
    therefore cuts the lost episodes short in its buffer (`buffer.cut(received.failed)`), forgets what it counted of
    them, notes the failures and resets these environments with fresh seeds; the reset may fail as any command may.
    What goes on failing raises from `receive`, so that no loop has to count.
    """

    signature: Signature
    size: int

    @abstractmethod
    def reset(self, environments: Sequence[int] | NDArray[np.int64], seeds: Sequence[int]) -> None:
        """Begin an episode in each environment named, with the seed that stands beside it. Does not wait."""

    @abstractmethod
    def step(self, environments: Sequence[int] | NDArray[np.int64], actions: FloatArray, *, updates: int = 0) -> None:
        """Hand each environment named its row of actions. Does not wait.

        `updates` says how many gradient updates the policy behind the actions had seen, and comes back with the step.
        """

    @abstractmethod
    def receive(self, at_least: int | None = None) -> Received:
        """Wait for all commands under way (lockstep), or until `at_least` environments have answered or failed (async).

        Gives all that has answered by then; 0 does not wait. The arrays are the caller's to keep.
        """

    @abstractmethod
    def parameters(self, environments: Sequence[int] | NDArray[np.int64]) -> FloatArray:
        """What domain randomization drew for the running episodes: (n, signature.parameters.size)."""

    def describe(self) -> dict[str, Any]:
        """How the environments share the machine, and what led to it, for the record; JSON-able."""
        return {}

    @abstractmethod
    def close(self) -> None:
        """End workers and free shared memory. Safe to call twice."""

    def __enter__(self) -> Orchestrator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
