"""The signature of environments: layouts of their inputs and outputs, the goal rule, and measures of episodes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
FloatArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
Kind = Literal["scalar", "point", "vector", "axial", "rotation", "wrench"]


@dataclass(frozen=True)
class Field:
    """Consecutive columns of a flat vector under one name."""

    name: str
    size: int
    unit: str = "1"
    critic_only: bool = False
    """Whether only critics observe it. Policies act without such fields, which stand at the end."""
    kind: Kind | tuple[Kind, ...] | None = None
    """How the field changes if the scene is moved along the floor or mirrored, see `augmentation`.

    scalar: nothing. point: a place in the world (x, y or x, y, z). vector: a difference of places, a velocity, a force,
    a direction. axial: a turn, an angular velocity, a torque (about x, y, z or only about z). rotation: the first two
    columns of a rotation matrix. wrench: a vector, then an axial one. Several kinds describe the columns in order: 3
    columns each, 6 for rotation and wrench, 1 for scalar. None: unknown.
    """
    joints: int = 0
    """How many joints it describes, one after the other, each in equally many columns; 0: it describes none."""


@dataclass(frozen=True)
class Layout:
    """The fields of a flat float32 vector, in order."""

    fields: tuple[Field, ...] = ()

    def __post_init__(self) -> None:
        names = [field.name for field in self.fields]
        if len(set(names)) != len(names):
            raise ValueError(f"a layout has a field name twice: {names}")

    @property
    def size(self) -> int:
        return sum(field.size for field in self.fields)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(field.name for field in self.fields)

    @property
    def acting(self) -> Layout:
        """The fields that a policy observes, without those that only critics observe."""
        return Layout(tuple(field for field in self.fields if not field.critic_only))

    def slice(self, name: str) -> slice:
        """The columns of the field. Raises KeyError for an unknown name."""
        start = 0
        for field in self.fields:
            if field.name == name:
                return slice(start, start + field.size)
            start += field.size
        raise KeyError(f"no field {name!r}; the layout has {', '.join(self.names) or 'none'}")

    def column(self, place: int) -> str:
        """The name of a column: its field, and its place there from 0."""
        names = [f"{field.name}[{inside}]" for field in self.fields for inside in range(field.size)]
        return names[place]

    def described(self) -> list[dict[str, Any]]:
        """Name, size and unit of each field, as JSON values."""
        return [{"name": field.name, "size": field.size, "unit": field.unit} for field in self.fields]

    def __add__(self, other: Layout) -> Layout:
        return Layout(self.fields + other.fields)


NO_FIELDS = Layout()


@dataclass(frozen=True)
class Discrete:
    """A discrete action set: an action is the index of one of these labels."""

    labels: tuple[str, ...]

    @property
    def size(self) -> int:
        """Columns of a stored action."""
        return 1

    def described(self) -> dict[str, list[str]]:
        """The labels, as JSON values."""
        return {"labels": list(self.labels)}


class GoalRule(ABC):
    """Reward, success and termination as functions of achieved and desired goal.

    The methods are pure and vectorised over leading axes. The object is picklable: environment, buffer and tests share
    it. `achieved` may have more columns than `desired`; its first columns are then the goal (see hindsight).
    """

    reward_range: tuple[float, float] = (-np.inf, np.inf)
    """The smallest and largest reward of one step."""

    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        """Reward of a step that arrives at `achieved` (..., a) with the goal `desired` (..., d): shape (...).

        By default it is sparse: 0 on success, else -1. The rule's `reward_range` is then (-1, 0).
        """
        return np.subtract(self.success(achieved, desired), 1, dtype=np.float32)

    @property
    def sparse(self) -> bool:
        """Whether the reward is 0 on success, else -1. It then follows from `success`."""
        return type(self).reward is GoalRule.reward

    @abstractmethod
    def success(self, achieved: Array, desired: Array) -> BoolArray:
        """Whether the goal is reached: shape (...)."""

    def terminated(self, achieved: Array, desired: Array) -> BoolArray:  # noqa: ARG002 (part of the interface)
        """Whether the step terminates the episode: shape (...); False by default."""
        return np.zeros(np.shape(achieved)[:-1], np.bool_)

    def distance(self, achieved: Array, desired: Array) -> FloatArray | None:  # noqa: ARG002 (part of the interface)
        """Distance to the goal in m: shape (...); inf where it is undefined. None: the rule has no distance."""
        return None

    def angle(self, achieved: Array, desired: Array) -> FloatArray | None:  # noqa: ARG002 (part of the interface)
        """Angle to the goal's orientation in rad: shape (...). None: the rule has no orientation."""
        return None


Better = Literal["smaller", "larger"]


@dataclass(frozen=True)
class Measure:
    """A number of an episode, known at its end; nan if it is undefined, e.g. the time to success of a failure."""

    name: str
    unit: str
    better: Better
    """Whether smaller or larger values are better."""
    description: str
    """One line."""

    def text(self, value: float) -> str:
        """A value for a person: "peak_force 21.9 N"."""
        return f"{self.name} {value:.3g}{'' if self.unit == '1' else f' {self.unit}'}"


SAME_LAYOUTS = "robots have the same layouts with cartesian control and the same task"
"""The hint for `layout_differences`."""


@dataclass(frozen=True)
class Signature:
    """All that agents and buffers know about an environment: layouts of inputs and outputs, goal rule. Picklable."""

    observation: Layout
    action: Layout | Discrete
    max_steps: int
    """Number of steps after which an episode is truncated."""
    reward_range: tuple[float, float] = (-np.inf, np.inf)
    extra_reward: tuple[float, float] = (0.0, 0.0)
    """Range of the part of a step's reward that does not depend on the goal. It is added to the goal rule's reward, and
    hindsight does not change it."""
    achieved_goal: Layout = NO_FIELDS
    desired_goal: Layout = NO_FIELDS
    goal_rule: GoalRule | None = None
    """None: the environment has no goals and empty goal layouts."""
    has_success: bool = True
    """Whether success is defined. False: results show only returns, unless a test has a success."""
    parameters: Layout = NO_FIELDS
    """The values that domain randomization samples at each reset, see `Environment.parameters`."""
    measures: tuple[Measure, ...] = ()
    """The measures of an episode, see `Environment.measures`. Their names differ."""

    def __post_init__(self) -> None:
        kinds: dict[str, Any] = dict.fromkeys(("observation", "achieved_goal", "desired_goal", "parameters"), Layout)
        for name, kind in {**kinds, "action": Layout | Discrete, "goal_rule": GoalRule | None}.items():
            if not isinstance(value := getattr(self, name), kind):
                wanted = "Layout or Discrete" if name == "action" else "GoalRule" if name == "goal_rule" else "Layout"
                raise TypeError(f"a signature's {name} must be a {wanted}, not {value!r}")
        if not isinstance(self.max_steps, Integral) or self.max_steps < 1:
            raise ValueError(f"a signature's max_steps must be a positive integer, not {self.max_steps!r}")
        for name in ("reward_range", "extra_reward"):
            if not (isinstance(span := getattr(self, name), Sequence) and len(span) == 2 and span[0] <= span[1]):
                raise ValueError(f"a signature's {name} must be (smallest, largest), not {span!r}")

    @property
    def observed_goal(self) -> tuple[list[int], list[int]]:
        """Columns of the desired goal, and the columns of observations with their achieved values.

        The n-th column of the achieved goal belongs to the n-th of the desired one. It is observed if
        policies observe a field of the same name and size.
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
    """Differences that prevent an agent trained on `trained` from acting on `acting`: one line per layout.

    With `learning` also differences that prevent its critics from learning.
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
