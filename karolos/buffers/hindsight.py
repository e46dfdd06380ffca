"""Hindsight experience replay: transitions with goals that their own episode achieved. Multi-step returns.

Source: Andrychowicz et al. 2017, "Hindsight Experience Replay". In addition to the paper, `terminated` is recomputed
under the new goal; otherwise values diverge on tasks that end on success.
"""

from __future__ import annotations

from typing import Literal, Self

import numpy as np
from pydantic import Field as Setting
from pydantic import model_validator

from ..core import Array, FloatArray, GoalRule, Signature, Transitions
from ..core import Settings as BaseSettings
from ..core.settings import LATER
from ..errors import PluginError, UsageError
from .storage import Slots, Storage, StoredTransitions

CHECKED_TRANSITIONS = 1000
"""Transitions that are compared with the goal rule at the start of a run."""


class Hindsight:
    """Relabels sampled transitions with goals that were achieved in their own episode.

    The new goal is the first `desired_goal.size` columns of the achieved goal after a step of the episode. Further
    columns of the achieved goal (e.g. the tool's position, for a dense reward) do not belong to the goal. The reward is
    computed from the goal achieved *after* the transition. A part that does not depend on the goal
    (`Signature.extra_reward`) stays the same. Observation and next observation share the goal.

    Raises:
        UsageError: the environment has no goals.
        PluginError: its achieved goal is smaller than its desired goal.
    """

    class Settings(BaseSettings):
        strategy: Literal["future", "final", "episode"] = Setting(
            "future",
            description="new goal: achieved at this or a later step, at the last step, or at any step of the episode",
        )
        ratio: float = Setting(0.8, ge=0, le=1, description="probability that a sampled transition gets a new goal")
        next_share: float = Setting(
            0.0,
            ge=0,
            le=1,
            description="share of the new goals that are the achieved goal of the transition itself, with every "
            "strategy: such a transition shows the effect of its action at once",
        )
        min_displacement: float = Setting(
            0.01,
            ge=0,
            description="keep the original goal if the new goal is closer than this to the goal achieved before the "
            "transition (in the goal's unit): nothing moved, so there is nothing to learn; 0: always relabel",
        )
        others_share: float = Setting(
            0.0,
            ge=0,
            le=1,
            json_schema_extra=LATER,
            description="share of the transitions without a new goal that get the desired goal of another sampled "
            "transition: so the agent also learns how an action serves other goals",
        )
        imitate: bool = Setting(
            False,
            description="the agent imitates relabelled transitions in the same way as demonstrations; needs "
            "agent.imitation",
        )

        @model_validator(mode="after")
        def _imitates_what_led_there(self) -> Self:
            if self.imitate and self.others_share:
                raise ValueError("others_share gives goals that an action did not lead to; set imitate: false with it")
            return self

    def __init__(self, settings: Hindsight.Settings, signature: Signature) -> None:
        if signature.goal_rule is None:
            raise UsageError(
                "hindsight needs an environment with goals",
                setting="buffer.hindsight",
                hint="remove buffer.hindsight, or choose an environment whose signature has a goal_rule",
            )
        if signature.achieved_goal.size < signature.desired_goal.size:
            raise PluginError(
                f"the achieved goal has {signature.achieved_goal.size} columns and the desired goal "
                f"{signature.desired_goal.size}; hindsight uses the first columns of the achieved goal as desired goal",
                setting="environment",
                hint="let achieved_goal begin with the columns of desired_goal",
            )
        self.settings = settings
        self._signature, self._rule = signature, signature.goal_rule
        self._size = signature.desired_goal.size
        self._checked = 0

    def check(self, transitions: Transitions) -> None:
        """Compare reward and `terminated` of the first transitions of a run with the goal rule.

        Raises:
            PluginError: they differ, so relabelled transitions would be wrong.
        """
        if self._checked >= CHECKED_TRANSITIONS:
            return
        self._checked += transitions.environment.size
        achieved, desired = transitions.next_achieved_goal, transitions.desired_goal
        reward, expected = np.asarray(transitions.reward), self._rule.reward(achieved, desired)
        low, high = self._signature.extra_reward
        wrong = np.flatnonzero(~np.isclose(reward, np.clip(reward, expected + low, expected + high), 1e-4, 1e-5))
        if wrong.size:
            raise PluginError(
                f"the environment gave reward {reward[wrong[0]]:g}, its goal rule says {expected[wrong[0]]:g}",
                setting="environment",
                hint="compute the reward with the goal rule, declare the range of what is added to it in the "
                "signature's extra_reward, or remove buffer.hindsight",
            )
        if np.any(self._rule.terminated(achieved, desired) & ~np.asarray(transitions.terminated, np.bool_)):
            raise PluginError(
                "the environment continued although its goal rule says that the episode is terminated",
                setting="environment",
                hint="let the step's `terminated` include the goal rule's",
            )

    def relabel(
        self, stored: StoredTransitions, slots: Slots, storage: Storage, generator: np.random.Generator
    ) -> Array:
        """Give randomly chosen transitions new goals, and recompute their `reward` and `terminated`, in place.

        Returns:
            The indices of these transitions.
        """
        # The slot of each transition's new goal: a stored step of its own episode.
        step = stored["step"].astype(np.int64)
        remaining = storage.lengths(slots, stored) - step  # including this step and the last
        if self.settings.strategy == "final":
            later = remaining - 1
        elif self.settings.strategy == "future":
            # An integer below `remaining`; scaling a float takes a third of the time of generator.integers.
            later = (generator.random(slots.size) * remaining).astype(np.int64)
        else:  # the ring may have overwritten the episode's first steps
            later = generator.integers(-np.minimum(step, storage.older(slots)), remaining)
        goal_slots = storage.shifted(slots, later)
        if self.settings.next_share:
            # Source: Özgür et al. 2025, "Next-Future", arXiv 2504.11247, where it is one new goal in four.
            achieves_it = generator.random(slots.size, np.float32) < self.settings.next_share
            goal_slots = np.where(achieves_it, slots, goal_slots)
        chosen = np.flatnonzero(generator.random(slots.size, np.float32) < self.settings.ratio)
        goals = storage.column("next_achieved_goal", goal_slots[chosen])[:, : self._size]
        if self.settings.min_displacement > 0:
            displacement = goals - stored["achieved_goal"].take(chosen, axis=0)[:, : self._size]
            moved = np.flatnonzero(np.vecdot(displacement, displacement) >= self.settings.min_displacement**2)
            chosen, goals = chosen[moved], goals.take(moved, axis=0)
        desired, terminated = stored["desired_goal"], stored["terminated"]
        if self.settings.others_share:
            # Source: the strategy "random" of Andrychowicz et al. 2017, with desired instead of achieved goals.
            swapped = generator.random(slots.size, np.float32) < self.settings.others_share
            swapped[chosen] = False
            others = np.flatnonzero(swapped)
            goals = np.concatenate((goals, desired[generator.integers(slots.size, size=others.size)]))
            chosen = np.concatenate((chosen, others))
        achieved = stored["next_achieved_goal"].take(chosen, axis=0)
        stored["reward"][chosen], terminated[chosen] = under_new_goals(
            self._signature, achieved, desired[chosen], goals, stored["reward"][chosen], terminated[chosen]
        )
        desired[chosen] = goals
        return chosen


def under_new_goals(
    signature: Signature, achieved: FloatArray, old: FloatArray, new: FloatArray, reward: FloatArray, terminated: Array
) -> tuple[FloatArray, Array]:
    """Reward and `terminated` (n,) of transitions whose goals change from `old` to `new`.

    The part of the reward that the rule does not give stays the same. So does a termination that the old goal does not
    explain, e.g. a fall.
    """
    rule = signature.goal_rule
    assert rule is not None
    changed: FloatArray = rule.reward(achieved, new)
    if signature.extra_reward != (0.0, 0.0):
        changed = np.add(changed, reward - rule.reward(achieved, old), dtype=np.float32)
    if type(rule).terminated is not GoalRule.terminated:  # otherwise goals terminate no episode
        other_cause = (terminated > 0) & ~rule.terminated(achieved, old)
        terminated = other_cause | rule.terminated(achieved, new)
    return changed, terminated


def extend(
    stored: StoredTransitions,
    slots: Slots,
    relabelled: Array,
    storage: Storage,
    signature: Signature,
    *,
    steps: int,
    discount: float,
) -> FloatArray:
    """Extend the transitions at `slots` (n,) to up to `steps` steps, in place.

    The reward becomes the discounted sum of the rewards of these steps. The next observation and `terminated` become
    those of the last step. A transition ends early where the episode terminates or is truncated, at the newest stored
    step, and where a relabelled goal is reached: the policy pursued another goal afterwards. Source: Sutton 1988;
    Hessel et al. 2018, "Rainbow".

    Args:
        relabelled: the indices of those that have new goals.
        steps: the largest number of steps.

    Returns:
        discount ** steps taken: (n,) float32.
    """
    gamma, rule = np.float32(discount), signature.goal_rule

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
        if new.any():
            old_goals = storage.column("desired_goal", next_slots[new])
            reward[new], terminated[new] = under_new_goals(
                signature, achieved[new], old_goals, goals[new], reward[new], terminated[new]
            )
        stored["reward"][index] += factor[index] * reward
        stored["next_observation"][index] = storage.column("next_observation", next_slots)
        stored["terminated"][index] = terminated
        factor[index] *= gamma
        active[index[terminated | (success(achieved, goals) & new)]] = False
    return factor
