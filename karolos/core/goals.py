"""When a goal is reached, and what that is worth."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from .arrays import Array, BoolArray, FloatArray


class GoalRule(ABC):
    """Reward, success and termination as functions of achieved and desired goal.

    The methods are pure and vectorised over leading axes. The object is picklable: environment, buffer and tests share
    it. `achieved` may have more columns than `desired`; its first columns are then the goal (see hindsight).
    """

    reward_range: tuple[float, float] = (-np.inf, np.inf)
    """The smallest and largest reward of one step."""

    @abstractmethod
    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        """Reward of a step that arrives at `achieved` (..., a) with the goal `desired` (..., d): shape (...)."""

    @abstractmethod
    def success(self, achieved: Array, desired: Array) -> BoolArray:
        """Whether the goal is reached: shape (...)."""

    def terminated(self, achieved: Array, desired: Array) -> BoolArray:  # noqa: ARG002 (part of the interface)
        """Whether the step terminates the episode: shape (...); False by default."""
        return np.zeros(np.shape(achieved)[:-1], np.bool_)

    def distance(self, achieved: Array, desired: Array) -> FloatArray | None:  # noqa: ARG002 (part of the interface)
        """Distance to the goal in m: shape (...); inf where it is undefined. None: the rule has no distance."""
        return None

    def angle(self, achieved: Array, desired: Array) -> FloatArray | None:  # noqa: ARG002 (part of the interface)
        """Angle to the goal's orientation in rad: shape (...). None: the rule has no orientation."""
        return None
