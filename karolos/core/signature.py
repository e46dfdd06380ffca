"""What an environment takes and gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray
from .goals import GoalRule
from .layout import NO_FIELDS, Discrete, Layout


@dataclass(frozen=True)
class Signature:
    """What an environment takes and gives: all that an agent or a buffer may know of it. Picklable."""

    observation: Layout
    action: Layout | Discrete
    max_steps: int
    """Steps after which an episode is truncated."""
    reward_range: tuple[float, float] = (-np.inf, np.inf)
    achieved_goal: Layout = NO_FIELDS
    desired_goal: Layout = NO_FIELDS
    goal_rule: GoalRule | None = None
    """None: the environment has no goals, and both goal layouts are empty."""
    parameters: Layout = NO_FIELDS
    """What domain randomization draws at each reset, in the order in which `Environment.parameters` gives it."""


def random_actions(signature: Signature, size: int, generator: np.random.Generator) -> FloatArray:
    """Uniform actions (size, action.size), for warm-up and for the floor that a random policy sets."""
    if isinstance(signature.action, Discrete):
        return generator.integers(len(signature.action.labels), size=(size, 1)).astype(np.float32)
    return generator.uniform(-1, 1, (size, signature.action.size)).astype(np.float32)
