"""Multi-step returns: sampled transitions that span several steps of their episode.

Source: Sutton 1988; Hessel et al. 2018, "Rainbow".
"""

from __future__ import annotations

import numpy as np

from ..core import Array, FloatArray, GoalRule
from .storage import Rows, Slots, Storage


class NStep:
    """Extends sampled transitions to up to `steps` steps, in place.

    The reward becomes the discounted sum of the rewards of these steps. The next observation and `terminated` become
    those of the last step. A transition ends early where the episode terminates or is truncated, at the newest stored
    step, and where a relabelled goal is reached: the policy pursued another goal afterwards.

    Args:
        steps: the largest number of steps, at least 2.
        discount: per step.
        storage: holds the transitions.
        rule: gives reward and `terminated` under relabelled goals; None in environments without goals.
    """

    def __init__(self, steps: int, discount: float, storage: Storage, rule: GoalRule | None) -> None:
        self.steps = steps
        self._discount = np.float32(discount)
        self._storage = storage
        self._rule = rule

    def extend(self, rows: Rows, slots: Slots, relabelled: Array) -> FloatArray:
        """Extend the rows of the transitions at `slots` (n,). The rows at the indices `relabelled` have new goals.

        Returns:
            discount ** steps taken: (n,) float32.
        """
        remaining = self._storage.lengths(slots, rows) - rows.number("step").astype(np.int64)
        new_goal = np.zeros(slots.size, np.bool_)
        new_goal[relabelled] = True
        factor = np.full(slots.size, self._discount, np.float32)
        reached = self._success(rows["next_achieved_goal"], rows["desired_goal"]) & new_goal
        active = (rows.number("terminated") == 0) & ~reached
        for step in range(1, self.steps):
            active = active & (remaining > step)
            index = np.flatnonzero(active)
            if not index.size:
                break
            next_slots = self._storage.shifted(slots[index], np.full(index.size, step))
            achieved = self._storage.column("next_achieved_goal", next_slots)
            reward = self._storage.column("reward", next_slots)[:, 0]
            terminated = self._storage.column("terminated", next_slots)[:, 0] > 0
            new, goals = new_goal[index], rows["desired_goal"][index]
            if self._rule is not None and new.any():
                old_goals = self._storage.column("desired_goal", next_slots[new])
                # A termination that the old goal does not explain (e.g. a fall) remains under the new goal.
                other_cause = terminated[new] & ~self._rule.terminated(achieved[new], old_goals)
                reward[new] = self._rule.reward(achieved[new], goals[new])
                terminated[new] = other_cause | self._rule.terminated(achieved[new], goals[new])
            rows.number("reward")[index] += factor[index] * reward
            rows["next_observation"][index] = self._storage.column("next_observation", next_slots)
            rows.number("terminated")[index] = terminated
            factor[index] *= self._discount
            active[index[terminated | (self._success(achieved, goals) & new)]] = False
        return factor

    def _success(self, achieved: FloatArray, goals: FloatArray) -> Array:
        if self._rule is None:
            return np.zeros(len(achieved), np.bool_)
        return np.asarray(self._rule.success(achieved, goals))
