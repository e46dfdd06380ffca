"""Multi-step returns: a transition that spans several steps of its episode (Sutton 1988; Hessel et al. 2018)."""

from __future__ import annotations

import numpy as np

from ..core import Array, FloatArray, GoalRule
from .storage import Rows, Slots, Storage


class NStep:
    """Turns sampled transitions into ones of up to `steps` steps, in place.

    The reward becomes the discounted sum of the rewards on the way, the next observation and the end those of the last
    step taken. The way ends early where the episode terminates or is truncated, at the newest step that is stored, and,
    under a relabelled goal, where that goal is reached: what the policy did afterwards was not meant for it.

    Args:
        steps: at most that many, at least 2.
        discount: per step.
        storage: where the transitions lie.
        rule: gives rewards and ends under relabelled goals; None where there are no goals.
    """

    def __init__(self, steps: int, discount: float, storage: Storage, rule: GoalRule | None) -> None:
        self.steps = steps
        self._discount = np.float32(discount)
        self._storage = storage
        self._rule = rule

    def extend(self, rows: Rows, slots: Slots, relabelled: Array) -> FloatArray:
        """Extend the rows of the transitions at `slots` (n,); those at the indices `relabelled` have new goals.

        Returns:
            discount ** steps taken: (n,) float32.
        """
        left = self._storage.lengths(slots, rows) - rows.number("step").astype(np.int64)
        new_goal = np.zeros(slots.size, np.bool_)
        new_goal[relabelled] = True
        factor = np.full(slots.size, self._discount, np.float32)
        going = (rows.number("terminated") == 0) & ~self._reached(rows["next_achieved_goal"], rows, new_goal)
        for step in range(1, self.steps):
            going = going & (left > step)
            here = np.flatnonzero(going)
            if not here.size:
                break
            there = self._storage.shifted(slots[here], np.full(here.size, step))
            achieved = self._storage.column("next_achieved_goal", there)
            reward = self._storage.column("reward", there)[:, 0]
            ended = self._storage.column("terminated", there)[:, 0] > 0
            under_new = new_goal[here]
            if self._rule is not None and under_new.any():
                reward, ended = self._under_new_goals(rows, here, there, achieved, (reward, ended), under_new)
            rows.number("reward")[here] += factor[here] * reward
            rows["next_observation"][here] = self._storage.column("next_observation", there)
            rows.number("terminated")[here] = ended
            factor[here] *= self._discount
            stopped = ended | (self._success(achieved, rows["desired_goal"][here]) & under_new)
            going[here[stopped]] = False
        return factor

    def _under_new_goals(
        self, rows: Rows, here: Array, there: Slots, achieved: FloatArray, stored: tuple[Array, Array], new: Array
    ) -> tuple[Array, Array]:
        """Rewards and ends of the steps `there`, asked again of the goal rule where the goal is a new one."""
        assert self._rule is not None
        reward, ended = stored
        goals = rows["desired_goal"][here[new]]
        old_goals = self._storage.column("desired_goal", there[new])
        # An end that the old goal does not explain (a fall, say) is one under the new goal too.
        for_other_reasons = ended[new] & ~self._rule.terminated(achieved[new], old_goals)
        reward[new] = self._rule.reward(achieved[new], goals)
        ended[new] = for_other_reasons | self._rule.terminated(achieved[new], goals)
        return reward, ended

    def _reached(self, achieved: FloatArray, rows: Rows, new_goal: Array) -> Array:
        return self._success(achieved, rows["desired_goal"]) & new_goal

    def _success(self, achieved: FloatArray, goals: FloatArray) -> Array:
        if self._rule is None:
            return np.zeros(len(achieved), np.bool_)
        return np.asarray(self._rule.success(achieved, goals))
