"""When a goal is reached, and what that is worth."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from .arrays import Array, BoolArray, FloatArray


class GoalRule(ABC):
    """When a goal is reached and what that is worth.

    Pure, vectorised over leading axes and picklable: environment, buffer and tests share one. `achieved` may carry more
    columns than `desired` names.
    """

    reward_range: tuple[float, float] = (-np.inf, np.inf)
    """The smallest and largest reward of one step."""

    @abstractmethod
    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        """Reward of arriving at `achieved` (..., a) when `desired` (..., d) is asked for: shape (...)."""

    @abstractmethod
    def success(self, achieved: Array, desired: Array) -> BoolArray:
        """Whether the goal holds: shape (...)."""

    def terminated(self, achieved: Array, desired: Array) -> BoolArray:  # noqa: ARG002 (part of the interface)
        """Whether arriving there ends the episode: shape (...). By default reaching a goal ends nothing."""
        return np.zeros(np.shape(achieved)[:-1], np.bool_)

    def distance(self, achieved: Array, desired: Array) -> FloatArray | None:  # noqa: ARG002 (part of the interface)
        """How far from the goal that is, in m: shape (...); inf where it does not count. None: the rule knows none."""
        return None
