"""The signature of environments: layouts of their inputs and outputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray
from .goals import GoalRule
from .layout import NO_FIELDS, Discrete, Layout
from .measures import Measure

SAME_LAYOUTS = "robots have the same layouts with cartesian control and the same task"
"""The hint for `layout_differences`."""


@dataclass(frozen=True)
class Signature:
    """Layouts of an environment's inputs and outputs: all that agents and buffers know about it. Picklable."""

    observation: Layout
    action: Layout | Discrete
    max_steps: int
    """Number of steps after which an episode is truncated."""
    reward_range: tuple[float, float] = (-np.inf, np.inf)
    extra_reward: tuple[float, float] = (0.0, 0.0)
    """Range of the part of a step's reward that does not depend on the goal: it is added to the goal rule's reward, and
    hindsight leaves it as it is."""
    achieved_goal: Layout = NO_FIELDS
    desired_goal: Layout = NO_FIELDS
    goal_rule: GoalRule | None = None
    """None: the environment has no goals and empty goal layouts."""
    has_success: bool = True
    """Whether success is defined. False: results show returns only, unless a test has a success all the same."""
    parameters: Layout = NO_FIELDS
    """The values that domain randomization draws at each reset, see `Environment.parameters`."""
    measures: tuple[Measure, ...] = ()
    """What an episode is measured by, see `Environment.measures`. No name is there twice."""

    @property
    def observed_goal(self) -> tuple[list[int], list[int]]:
        """Columns of the desired goal, and the columns of observations that hold what is achieved of them.

        The n-th column of the achieved goal belongs to the n-th of the desired one. It is observed where the layout of
        what policies observe has a field of the same name and size.
        """
        observed, places, columns = self.observation.acting, list[int](), list[int]()
        sizes = {(field.name, field.size) for field in observed.fields}
        for field in self.achieved_goal.fields:
            part = self.achieved_goal.slice(field.name)
            if (field.name, field.size) in sizes and part.stop <= self.desired_goal.size:
                places += range(part.start, part.stop)
                columns += range(observed.size)[observed.slice(field.name)]
        return places, columns


def random_actions(signature: Signature, size: int, generator: np.random.Generator) -> FloatArray:
    """Uniformly random actions (size, action.size)."""
    if isinstance(signature.action, Discrete):
        return generator.integers(len(signature.action.labels), size=(size, 1)).astype(np.float32)
    return generator.uniform(-1, 1, (size, signature.action.size)).astype(np.float32)


def layout_differences(acting: Signature, trained: Signature, *, learning: bool = False) -> list[str]:
    """The differences that prevent an agent trained on `trained` from acting on `acting`: one line for each layout.

    With `learning` also those that prevent its critics from learning on.
    """
    lines = []
    for part in ("observation", "action", "desired_goal"):
        layouts = [getattr(signature, part) for signature in (acting, trained)]
        if part == "observation" and not learning:
            layouts = [layout.acting for layout in layouts]
        acted, learned = map(_field_texts, layouts)
        if acted != learned:
            missing = [field for field in learned if field not in acted]
            extra = [field for field in acted if field not in learned]
            details = [f"only there: {', '.join(missing)}"] if missing else []
            details += [f"only here: {', '.join(extra)}"] if extra else []
            detail = "; ".join(details) or "the order differs"
            lines.append(f"{part} is [{', '.join(acted)}] here and [{', '.join(learned)}] there ({detail})")
    return lines


def _field_texts(layout: Layout | Discrete) -> list[str]:
    if isinstance(layout, Discrete):
        return list(layout.labels)
    return [f"{field.name} {field.size} {field.unit}" for field in layout.fields]
