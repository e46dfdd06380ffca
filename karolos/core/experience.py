"""What flows from environments through buffers to agents."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from typing_extensions import TypeVar

from .arrays import BoolArray, FloatArray


class Step(NamedTuple):
    """What an environment gives back after a reset or a step. Leading axes: none, or one over environments."""

    observation: FloatArray
    achieved_goal: FloatArray
    desired_goal: FloatArray
    reward: Any
    terminated: Any
    truncated: Any
    success: Any
    """Whether the goal holds now. After a reset: reward 0, neither terminated nor truncated."""
    diverged: Any = False
    """Whether the simulation left all sense (NaN, an object far away). The step is truncated then, its values are those
    of the last sound one, and it is no experience: training counts it and keeps it from the buffer."""


class Transitions(NamedTuple):
    """One transition of each of n environments, as they come from collecting. All arrays have the leading axis n.

    Successive calls that name the same environment continue its episode until terminated or truncated.
    """

    environment: NDArray[np.int64]
    observation: FloatArray
    achieved_goal: FloatArray
    desired_goal: FloatArray
    action: FloatArray
    reward: FloatArray
    next_observation: FloatArray
    next_achieved_goal: FloatArray
    terminated: BoolArray
    truncated: BoolArray


class Batch(NamedTuple):
    """n transitions to learn from, goals possibly relabelled; arrays with the leading axis n.

    Target of a value: reward + discount * (1 - terminated) * value(next_observation, desired_goal).
    """

    observation: FloatArray
    desired_goal: FloatArray
    action: FloatArray
    reward: FloatArray
    next_observation: FloatArray
    terminated: FloatArray
    """1 where no value lies beyond, else 0. Truncated transitions carry 0."""
    discount: FloatArray
    """gamma ** (environment steps between observation and next_observation)."""
    weight: FloatArray
    """Importance weights; 1 for uniform sampling."""
    slot: NDArray[np.int64]
    """Where each transition lies in the buffer, for `Buffer.update_priorities`."""
    demonstrated: FloatArray | None = None
    """1 where an expert took the action, else 0; None: the buffer holds no demonstrations."""


class Rollout(NamedTuple):
    """What n environments played under one policy: at most T successive transitions of each, in their order.

    Arrays with the leading axes (T, n). Where an environment has fewer than T, the rows after its last are not
    `stored`.
    """

    observation: FloatArray
    desired_goal: FloatArray
    action: FloatArray
    """As the agent gave them, before they were clipped to what the environment takes."""
    reward: FloatArray
    next_observation: FloatArray
    terminated: BoolArray
    """No value lies beyond."""
    ended: BoolArray
    """The row after this one does not continue its episode: terminated, truncated, cut short, or nothing follows."""
    stored: BoolArray


Experience = TypeVar("Experience", Batch, Rollout, default=Batch)
"""What an agent learns from and a buffer gives: a Batch of old transitions, or (on-policy) a whole Rollout."""
