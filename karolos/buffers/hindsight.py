"""Hindsight: a transition is also one on the way to a goal that its episode reached later.

Source: Andrychowicz et al. 2017, "Hindsight Experience Replay". Beyond it, whether the episode ends is asked again of
the goal rule under the new goal; without that, values blow up on tasks that end on success.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field as Setting

from ..core import Array, GoalRule, Signature, Transitions
from ..core import Settings as BaseSettings
from ..errors import PluginError, UsageError
from .storage import Rows, Slots, Storage

CHECKED_TRANSITIONS = 1000
"""How many transitions are compared with the goal rule at the start of a run."""


class Hindsight:
    """Gives sampled transitions goals that were achieved in their own episode.

    The new goal is the first `desired_goal.size` columns of the achieved goal after some step of the episode; further
    columns of the achieved goal (the tool's position, for a dense reward) are no part of a goal. The reward is that of
    the goal achieved *after* the transition. One goal holds for the observation and the next observation.

    Args:
        settings: what to relabel with.
        signature: of the environments; must have goals.

    Raises:
        UsageError: the environment has no goals.
        PluginError: its achieved goal is smaller than its desired goal.
    """

    class Settings(BaseSettings):
        strategy: Literal["future", "final", "episode"] = Setting(
            "future", description="goal achieved at a later step, at the last, or at any step of the episode"
        )
        ratio: float = Setting(0.8, ge=0, le=1, description="share of sampled transitions that get a new goal")
        min_displacement: float = Setting(
            0.01,
            ge=0,
            description="keep the original goal where the new one lies closer than this (in the goal's unit) to what "
            "was achieved before the transition: nothing moved, so nothing is to be learned from it; 0: never keep",
        )

    def __init__(self, settings: Hindsight.Settings, signature: Signature) -> None:
        if signature.goal_rule is None:
            raise UsageError(
                "hindsight needs an environment with goals, and this one has none",
                where="buffer.hindsight",
                hint="remove buffer.hindsight, or choose an environment whose signature has a goal_rule",
            )
        if signature.achieved_goal.size < signature.desired_goal.size:
            raise PluginError(
                f"the achieved goal has {signature.achieved_goal.size} columns and the desired goal "
                f"{signature.desired_goal.size}; hindsight takes the leading columns of the one for the other",
                where="environment",
                hint="let achieved_goal begin with the columns of desired_goal",
            )
        self.settings = settings
        self._rule = signature.goal_rule
        self._ends = type(signature.goal_rule).terminated is not GoalRule.terminated
        """Whether reaching a goal can end an episode."""
        self._size = signature.desired_goal.size
        self._checked = 0

    def check(self, transitions: Transitions) -> None:
        """Compare the first transitions of a run with the goal rule, which must have made their rewards and ends.

        Raises:
            PluginError: the environment's reward or termination is not the goal rule's; relabelled ones would be wrong.
        """
        if self._checked >= CHECKED_TRANSITIONS:
            return
        self._checked += transitions.environment.size
        achieved, desired = transitions.next_achieved_goal, transitions.desired_goal
        given, ruled = np.asarray(transitions.reward), self._rule.reward(achieved, desired)
        wrong = np.flatnonzero(~np.isclose(given, ruled, rtol=1e-4, atol=1e-5))
        if wrong.size:
            raise PluginError(
                f"the environment gave reward {given[wrong[0]]:g} where its goal rule says {ruled[wrong[0]]:g}",
                where="environment",
                hint="rewards must come from the goal rule alone when hindsight is used; or remove buffer.hindsight",
            )
        if np.any(self._rule.terminated(achieved, desired) & ~np.asarray(transitions.terminated, np.bool_)):
            raise PluginError(
                "the environment went on where its goal rule says that the episode is terminated",
                where="environment",
                hint="let the step's `terminated` include the goal rule's",
            )

    def relabel(self, rows: Rows, slots: Slots, storage: Storage, generator: np.random.Generator) -> Array:
        """Give a random share of the rows other goals, and the rewards and ends that follow; in place.

        Returns:
            The indices of those rows.
        """
        goal_slots = self._goal_slots(rows, slots, storage, generator)
        chosen = np.flatnonzero(generator.random(slots.size, np.float32) < self.settings.ratio)
        goals = storage.column("next_achieved_goal", goal_slots[chosen])[:, : self._size]
        if self.settings.min_displacement > 0:
            way = goals - rows["achieved_goal"].take(chosen, axis=0)[:, : self._size]
            moved = np.flatnonzero(np.vecdot(way, way) >= self.settings.min_displacement**2)
            chosen, goals = chosen[moved], goals.take(moved, axis=0)
        achieved = rows["next_achieved_goal"].take(chosen, axis=0)
        desired, terminated = rows["desired_goal"], rows.number("terminated")
        if self._ends:
            # An end that the old goal does not explain (a fall, say) is one under the new goal too.
            for_other_reasons = (terminated[chosen] > 0) & ~self._rule.terminated(achieved, desired[chosen])
            terminated[chosen] = for_other_reasons | self._rule.terminated(achieved, goals)
        rows.number("reward")[chosen] = self._rule.reward(achieved, goals)
        desired[chosen] = goals
        return chosen

    def _goal_slots(self, rows: Rows, slots: Slots, storage: Storage, generator: np.random.Generator) -> Array:
        """Where the goal of each row comes from: always a step of the row's own episode that is still stored."""
        step = rows.number("step").astype(np.int64)
        left = storage.lengths(slots, rows) - step  # steps from this one to the last, both counted
        if self.settings.strategy == "final":
            return storage.shifted(slots, left - 1)
        if self.settings.strategy == "future":
            # an index below `left`; drawn as a share of it, in a third of the time that integers take
            return storage.shifted(slots, (generator.random(slots.size) * left).astype(np.int64))
        kept_before = np.minimum(step, storage.older(slots))  # the ring may have overwritten the episode's beginning
        return storage.shifted(slots, generator.integers(-kept_before, left))
