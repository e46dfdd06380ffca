"""What an environment takes and gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray
from .goals import GoalRule
from .layout import NO_FIELDS, Discrete, Layout

SAME_LAYOUTS = "robots have the same layouts where control is cartesian and the task is the same"
"""Hint for whoever meets `layout_differences`."""


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


def layout_differences(here: Signature, there: Signature) -> list[str]:
    """Why an agent trained on `there` cannot act on `here`: one line for each layout that differs, with both sides."""
    told = []
    for part in ("observation", "action", "desired_goal"):
        mine, its = _field_texts(getattr(here, part)), _field_texts(getattr(there, part))
        if mine != its:
            lacking, more = [field for field in its if field not in mine], [field for field in mine if field not in its]
            what = "; ".join(
                text
                for text in (
                    f"only there: {', '.join(lacking)}" if lacking else "",
                    f"only here: {', '.join(more)}" if more else "",
                    "" if lacking or more else "the order differs",
                )
                if text
            )
            told.append(f"{part} is [{', '.join(mine)}] here and [{', '.join(its)}] there ({what})")
    return told


def _field_texts(layout: Layout | Discrete) -> list[str]:
    if isinstance(layout, Discrete):
        return list(layout.labels)
    return [f"{field.name} {field.size} {field.unit}" for field in layout.fields]
