"""How well a policy that needs no training does: a scripted expert, or random actions, which set the floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core import Environment, Step, random_actions
from ..core.seeding import SeedTree
from ..statistics.intervals import wilson
from .playing import Policy, play


@dataclass(frozen=True)
class Score:
    """Success in episodes that were played."""

    episodes: int
    success_any: float
    """Share of episodes in which the goal was reached at some step."""
    success_end: float
    """Share in which it held at the last step."""
    low: float
    """End of the 95 % Wilson interval of `success_end`."""
    high: float
    steps: float | None
    """Mean step at which the goal was first reached, over the episodes in which it was; None where it never was."""


def score(environment: Environment, policy: Policy, *, episodes: int, seed: int) -> Score:
    """Play the first `episodes` test episodes under the root `seed`."""
    firsts: list[int] = []
    ends = 0
    reached: int | None = None
    for moment in play(environment, policy, episodes=episodes, seed=seed):
        if moment.step == 0:
            reached = None
        if moment.success and reached is None:
            reached = moment.step
        if moment.over:
            ends += moment.success
            firsts += [] if reached is None else [reached]
    low, high = wilson(ends, episodes)
    mean = sum(firsts) / len(firsts) if firsts else None
    return Score(episodes, len(firsts) / episodes, ends / episodes, low, high, mean)


def random_policy(environment: Environment, seed: int) -> Policy:
    """Uniformly random actions from a stream of their own under `seed`."""
    generator = SeedTree(seed).child("random policy").generator()

    def act(_: Step) -> NDArray[np.float32]:
        return np.asarray(random_actions(environment.signature, 1, generator)[0])

    return Policy(act)
