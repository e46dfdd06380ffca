"""The interfaces of environments and of the scripted experts that solve them."""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError, described
from .experience import Step
from .signature import Array, FloatArray, Signature

STAGE = "task.start_"
"""Beginning of the names of parameters that are probabilities of stages, in which training episodes may begin."""


class Expert(ABC):
    """A scripted policy of an environment. It shows that a task can be solved, and gives demonstrations.

    Order of calls: `reset` after the environment's reset, then `act` before each step. The expert of a task uses the
    robot's view only, so it works with any robot and control mode.
    """

    def reset(self) -> None:  # noqa: B027 (an expert without a state has nothing to reset)
        """Start a new episode."""

    @abstractmethod
    def act(self) -> FloatArray:
        """The next action: (action.size,)."""


class Environment(ABC):
    """One environment: `reset` begins an episode, `step` takes one action until the episode ends.

    Determinism. The seed and the actions determine the episode bit for bit, in a new and in a used environment. Random
    numbers come from generators made from the seed; the environment uses no global generator.

    Steps. Every Step has the shapes of `signature`, without a leading axis. Returned arrays belong to the caller: the
    environment does not change them later. After a reset `reward` is 0, and `terminated` and `truncated` are False.
    `truncated` is True at step `signature.max_steps` at the latest. If `signature.goal_rule` is set, `success` is that
    of the rule, but False if a protective stop ends the episode. `terminated` is True whenever the rule terminates.
    Hindsight needs the reward of the rule. If the environment does not define success, `signature.has_success` is
    False, and results show only returns.

    Errors. An environment may raise any exception. The orchestrator then reports the episode as lost and builds the
    environment again. When the simulation diverges, return a Step with `diverged`, `truncated` and reward 0.

    Processes. An environment is built, stepped and closed by one thread, often of a worker process. Its module should
    not import torch.
    """

    signature: Signature
    """Shapes, names and the goal rule. It depends only on the environment's settings and does not change."""
    rate: float = 24
    """Control steps per second of real time, at which films and windows show it."""

    @abstractmethod
    def reset(self, seed: int) -> Step:
        """Begin the episode of `seed` (>= 0), also in the middle of another episode; returns its first state."""

    @abstractmethod
    def step(self, action: Array) -> Step:
        """Take one action: (action.size,) float32 in [-1, 1], or an index of a discrete set.

        Raises RuntimeError after the end of an episode and before the first reset.
        """

    def parameters(self) -> FloatArray:
        """The values that domain randomization sampled for this episode, in the layout `signature.parameters`.

        For the probability of a stage (`STAGE`) it is 1 if the episode began in the stage, else 0.
        """
        return np.zeros(0, np.float32)

    def measures(self) -> FloatArray:
        """The values of `signature.measures` for the episode that has just ended, in their order; nan: undefined.

        It is called at the end of an episode, before the next reset.
        """
        return np.full(len(self.signature.measures), np.nan, np.float32)

    def expert(self) -> Expert:
        """The scripted policy of the running episode. Raises UsageError if there is none."""
        raise UsageError("there is no expert for this environment", setting="environment", hint="tasks have experts")

    def render(self, width: int = 640, height: int = 480) -> NDArray[np.uint8]:
        """An image of the current state: (height, width, 3). Raises NotImplementedError without rendering."""
        raise NotImplementedError(f"{type(self).__name__} cannot render")

    def film(self, pictures: int, width: int = 640, height: int = 480) -> Iterator[NDArray[np.uint8]]:
        """Pictures of the time since the last one, evenly spaced; the last shows the current state.

        Without an implementation of its own, an environment shows the current state in all pictures.
        """
        yield from [self.render(width, height)] * pictures

    def close(self) -> None:  # noqa: B027 (nothing to free by default)
        """Release resources. Safe to call twice."""


@dataclass(frozen=True)
class Moment:
    """A step of a played episode, for spectators."""

    episode: int
    """Number of the episode, from 0."""
    step: int
    """Steps so far; 0 after the reset."""
    success: bool
    over: bool
    """Whether the episode ends here."""
    total: float
    """Sum of the rewards so far."""
    environment: Environment
    """For pictures: `environment.render()`."""


def close(environment: Environment) -> None:
    """Close an environment that is no longer needed. An error changes no result and becomes a line on stderr."""
    try:
        environment.close()
    except (Exception, SystemExit, KeyboardInterrupt) as error:  # a plugin may raise anything
        print(f"warning: {type(environment).__name__}.close failed: {described(error)}", file=sys.stderr)
