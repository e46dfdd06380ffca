"""Multi-step returns: sampled transitions that span several steps of their episode.

Source: Sutton 1988; Hessel et al. 2018, "Rainbow".
"""

from __future__ import annotations

import numpy as np

from ..core import Array, FloatArray, GoalRule
from .hindsight import relabelled_reward
from .storage import Slots, Storage, StoredTransitions


def extend(
    stored: StoredTransitions,
    slots: Slots,
    relabelled: Array,
    storage: Storage,
    rule: GoalRule | None,
    *,
    steps: int,
    discount: float,
    extra: tuple[float, float] = (0.0, 0.0),
) -> FloatArray:
    """Extend the transitions at `slots` (n,) to up to `steps` steps, in place.

    The reward becomes the discounted sum of the rewards of these steps. The next observation and `terminated` become
    those of the last step. A transition ends early where the episode terminates or is truncated, at the newest stored
    step, and where a relabelled goal is reached: the policy pursued another goal afterwards.

    Args:
        stored: the transitions.
        slots: theirs.
        relabelled: the indices of those that have new goals.
        storage: holds the transitions.
        rule: gives reward and `terminated` under relabelled goals; None in environments without goals.
        steps: the largest number of steps.
        discount: per step.
        extra: range of what the rewards add to the rule's, see `Signature.extra_reward`.

    Returns:
        discount ** steps taken: (n,) float32.
    """
    gamma = np.float32(discount)

    def success(achieved: FloatArray, goals: FloatArray) -> Array:
        return np.zeros(len(achieved), np.bool_) if rule is None else np.asarray(rule.success(achieved, goals))

    remaining = storage.lengths(slots, stored) - stored["step"].astype(np.int64)
    new_goal = np.zeros(slots.size, np.bool_)
    new_goal[relabelled] = True
    factor = np.full(slots.size, gamma, np.float32)
    active = (stored["terminated"] == 0) & ~(success(stored["next_achieved_goal"], stored["desired_goal"]) & new_goal)
    for step in range(1, steps):
        active = active & (remaining > step)
        index = np.flatnonzero(active)
        if not index.size:
            break
        next_slots = storage.shifted(slots[index], np.full(index.size, step))
        achieved = storage.column("next_achieved_goal", next_slots)
        reward = storage.column("reward", next_slots)
        terminated = storage.column("terminated", next_slots) > 0
        new, goals = new_goal[index], stored["desired_goal"][index]
        if rule is not None and new.any():
            old_goals = storage.column("desired_goal", next_slots[new])
            # A termination that the old goal does not explain (e.g. a fall) remains under the new goal.
            other_cause = terminated[new] & ~rule.terminated(achieved[new], old_goals)
            reward[new] = relabelled_reward(rule, achieved[new], old_goals, goals[new], reward[new], extra)
            terminated[new] = other_cause | rule.terminated(achieved[new], goals[new])
        stored["reward"][index] += factor[index] * reward
        stored["next_observation"][index] = storage.column("next_observation", next_slots)
        stored["terminated"][index] = terminated
        factor[index] *= gamma
        active[index[terminated | (success(achieved, goals) & new)]] = False
    return factor
