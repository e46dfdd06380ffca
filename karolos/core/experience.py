"""The data that goes from environments through buffers to agents."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from typing_extensions import TypeVar

from .signature import BoolArray, Field, FloatArray, Layout, Signature

State = dict[str, Any]
"""The state of a part: nested dicts of arrays, tensors, numbers and strings; no other objects."""


class Step(NamedTuple):
    """The result of a reset or a step. Leading axes: none, or one over environments."""

    observation: FloatArray
    achieved_goal: FloatArray
    desired_goal: FloatArray
    reward: Any
    terminated: Any
    truncated: Any
    success: Any
    """Whether the goal is reached in this state."""
    diverged: Any = False
    """Whether the simulation diverged (NaN, an object far away). The step is then truncated, has the reward 0,
    and repeats the other values of the last valid step. Training counts it and does not add it to the buffer."""

    @classmethod
    def zeros(cls, signature: Signature, environments: int) -> Step:
        """The step of each environment, to be written to."""
        vectors = signature.observation, signature.achieved_goal, signature.desired_goal
        observation, achieved, desired = (np.zeros((environments, vector.size), np.float32) for vector in vectors)
        terminated, truncated, success, diverged = np.zeros((4, environments), np.bool_)
        reward = np.zeros(environments, np.float32)
        return cls(observation, achieved, desired, reward, terminated, truncated, success, diverged)

    def write(self, environments: NDArray[np.int64], step: Step) -> None:
        """Overwrite the steps of these environments (n,) by the rows of another step."""
        for array, rows in zip(self, step, strict=True):
            array[environments] = rows

    def select(self, which: NDArray[Any]) -> Step:
        """The steps of environments, by indices or by a mask: a copy."""
        return Step(*(array[which] for array in self))


class Transitions(NamedTuple):
    """One transition of each of n environments. All arrays have the leading axis n."""

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


SCALARS = ("reward", "terminated", "step", "length")
"""Fields of one number."""


def transition_layout(signature: Signature) -> Layout:
    """The columns of a stored transition.

    `step`: index of the step in its episode, from 0. `length`: steps of the whole episode; 0 while it runs.
    """
    observation, achieved = signature.observation.size, signature.achieved_goal.size
    return Layout(
        (
            Field("observation", observation),
            Field("next_observation", observation),
            Field("achieved_goal", achieved),
            Field("next_achieved_goal", achieved),
            Field("desired_goal", signature.desired_goal.size),
            Field("action", signature.action.size),
            *(Field(name, 1) for name in SCALARS),
        )
    )


class Batch(NamedTuple):
    """n transitions to learn from, with goals possibly relabelled; arrays with the leading axis n.

    The target of a value is reward + discount * (1 - terminated) * value(next_observation, desired_goal).
    """

    observation: FloatArray
    desired_goal: FloatArray
    action: FloatArray
    reward: FloatArray
    next_observation: FloatArray
    terminated: FloatArray
    """1 where the episode terminated, else 0; also 0 for truncated transitions."""
    discount: FloatArray
    """gamma ** (environment steps between observation and next_observation)."""
    weight: FloatArray
    """Importance weights; 1 for uniform sampling."""
    slot: NDArray[np.int64]
    """Identifies each transition in the buffer, for `Buffer.update_priorities`."""
    demonstrated: FloatArray | None = None
    """1 for transitions to imitate, else 0: demonstrations, and relabelled ones if hindsight says so. None: there are
    no such transitions."""


class Rollout(NamedTuple):
    """Successive transitions of n environments under one policy, at most T of each.

    Arrays have the leading axes (T, n). If an environment has fewer than T transitions, its last rows are not `stored`.
    """

    observation: FloatArray
    desired_goal: FloatArray
    action: FloatArray
    """The agent's actions before they were clipped for the environment."""
    reward: FloatArray
    next_observation: FloatArray
    terminated: BoolArray
    """The next state has no value."""
    ended: BoolArray
    """The next row does not continue the episode: terminated, truncated, cut, or the last row."""
    stored: BoolArray


Experience = TypeVar("Experience", Batch, Rollout, default=Batch)
"""The result of `Buffer.sample`, from which an agent learns: a Batch, or a Rollout if on-policy."""
