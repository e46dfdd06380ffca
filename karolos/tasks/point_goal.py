"""Goals that are positions: rule, settings, and the common part of the tasks reach, push and pick_place."""

from __future__ import annotations

from collections.abc import Callable
from math import hypot
from typing import Literal

import numpy as np
from pydantic import Field as Setting

from ..core import Array, BoolArray, Field, FloatArray, Generator, GoalRule, Layout, Settings
from ..errors import RunError, UsageError
from ..simulation.geometry import Vector
from ..simulation.interface import Box, Task, World

PLACE_ATTEMPTS = 1000
GOAL_COLOUR = (0.16, 0.74, 0.32, 0.5)
"""Colour of the marker that shows a goal."""


class PointGoal(GoalRule):
    """Success if the distance of `achieved` (..., 3) from `desired` (..., 3) is below `threshold`, in m.

    Sparse reward: 0 on success, else -1. Dense reward: minus the distance in m.

    Args:
        span: the largest possible distance in m; it bounds the dense reward.
    """

    place = slice(None)
    """Columns of both goals with the position."""

    def __init__(self, threshold: float, *, dense: bool, span: float) -> None:
        self.threshold = threshold
        self.dense = dense
        self.reward_range = (-span, 0.0) if dense else (-1.0, 0.0)
        self._squared = np.float32(threshold**2)

    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        return -self.loss(achieved, desired) if self.dense else super().reward(achieved, desired)

    @property
    def sparse(self) -> bool:
        return not self.dense and type(self).reward is PointGoal.reward

    def loss(self, achieved: Array, desired: Array) -> FloatArray:
        """Minus the dense reward, here the distance in m: shape (...)."""
        return self.distance(achieved, desired)

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        near: BoolArray = self._squares(achieved, desired) < self._squared
        return near

    def distance(self, achieved: Array, desired: Array) -> FloatArray:
        metres: FloatArray = np.sqrt(self._squares(achieved, desired), dtype=np.float32)
        return metres

    def _squares(self, achieved: Array, desired: Array) -> Array:
        """The square of the distance in m2: shape (...)."""
        difference = achieved[..., self.place] - desired[..., self.place]
        # vecdot takes three times as long for a step of an environment
        squares: Array = difference.dot(difference) if difference.ndim == 1 else np.vecdot(difference, difference)
        return squares


class Places(PointGoal):
    """Several positions at once, and whether the objects are released: e.g. the places of stacked cubes.

    `achieved` and `desired` (..., 3 n + 1): n positions in m, and 1 if all objects are released and at rest, else 0.
    With 0 in `desired` the last number does not matter. Sparse reward: minus the share of objects that are not in their
    place; the last object also counts until all are released. The distance is that of the furthest object.
    """

    def __init__(self, threshold: float) -> None:
        super().__init__(threshold, dense=False, span=1.0)

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        left: BoolArray = achieved[..., -1] >= desired[..., -1]
        return left & (self.distance(achieved, desired) < self.threshold)

    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        near = self._distances(achieved, desired) < self.threshold
        number, left = near.shape[-1], achieved[..., -1] >= desired[..., -1]
        placed = np.minimum(near.sum(-1), np.where(left, number, number - 1))
        return np.asarray(placed / number - 1, np.float32)

    def distance(self, achieved: Array, desired: Array) -> FloatArray:
        metres: FloatArray = self._distances(achieved, desired).max(-1)
        return metres

    def _distances(self, achieved: Array, desired: Array) -> FloatArray:
        off = (achieved - desired)[..., :-1]
        off = off.reshape(*off.shape[:-1], off.shape[-1] // 3, 3)  # also for zero goals
        metres: FloatArray = np.sqrt(np.vecdot(off, off), dtype=np.float32)
        return metres


HIGHEST_HELD = 0.15
"""Largest height in m of an object that is to be held, above where it rests."""


def check_threshold(threshold: float, box: Box) -> None:
    """Raises UsageError when a position in the box may be near every goal in it."""
    if 2 * threshold >= box.diagonal:
        raise UsageError(
            f"{threshold:g} m leaves no goal to reach",
            setting="task.threshold",
            hint=f"goals lie in a box with a diagonal of {box.diagonal:.2f} m; take a smaller threshold",
        )


def sample_apart(generator: Generator, box: Box, number: int, apart: float, what: str) -> list[Vector]:
    """`number` positions in m in the box, each further than `apart` m from the others along the floor."""
    places: list[Vector] = []

    def far(one: FloatArray) -> bool:
        return all(hypot(one[0] - x, one[1] - y) > apart for x, y, _ in places)

    for _ in range(number):
        x, y, z = sample_position(generator, box, what, far).tolist()
        places.append((x, y, z))
    return places


def sample_held(generator: Generator, ground: Box, base: Vector) -> FloatArray:
    """A goal (4,) of `Places`: an object up to `HIGHEST_HELD` above the ground, in m from `base`, released or not."""
    x, y, z = sample_position(generator, ground, "the object to hold").tolist()
    height = z - base[2] + HIGHEST_HELD * generator.uniform()
    return np.array((x - base[0], y - base[1], height, 0.0), np.float32)


def sample_position(
    generator: Generator, box: Box, what: str, accepted: Callable[[FloatArray], bool] | None = None
) -> FloatArray:
    """A position (3,) in m, uniform among the accepted ones in the box. Raises RunError after 1000 rejected positions.

    Args:
        what: name of the placed thing, for the error.
        accepted: whether a position is accepted; all are by default.
    """
    for _ in range(PLACE_ATTEMPTS):
        position = generator.uniform(box.low, box.high).astype(np.float32)
        if accepted is None or accepted(position):
            return position
    low, high = (" ".join(f"{round(number, 3):g}" for number in end) for end in (box.low, box.high))
    raise RunError(
        f"found no place for {what} in {PLACE_ATTEMPTS} attempts",
        hint=f"the box is {low} to {high} m; a smaller threshold or another range leaves more room",
    )


class PointGoalSettings(Settings):
    """Settings of every task with a point goal."""

    reward: Literal["sparse", "dense"] = Setting("sparse", description="-1 until success, or minus the distance in m")
    threshold: float = Setting(0.05, gt=0, le=0.5, description="distance at which the goal is reached, m")
    goals: Literal["box", "workspace"] = Setting(
        "box", description="goals in a box with edges of 0.3 m in the middle of the workspace, or in all of it"
    )
    max_steps: int = Setting(50, ge=1, le=100_000, description="control steps per episode")


class PointGoalTask(Task):
    """A task with a point goal. `fit` of a subclass calls `_fit_goal`, its `reset` calls `_sample_goal`."""

    settings: PointGoalSettings
    desired_goal = Layout((Field("goal_position", 3, "m", kind="point"),))

    def _fit_goal(self, box: Box, span: float) -> None:
        """Set the goal rule for goals in `box`. `span`: the largest possible distance from a goal in m."""
        check_threshold(self.settings.threshold, box)
        self.goal_rule = PointGoal(self.settings.threshold, dense=self.settings.reward == "dense", span=span)

    def build(self, world: World) -> None:
        super().build(world)
        self._marker = world.marker(self.settings.threshold, GOAL_COLOUR)

    def _sample_goal(self, generator: Generator, box: Box) -> None:
        """Sample a goal in `box` that is not achieved yet, and mark it."""
        start = self.achieved()
        self.goal = sample_position(generator, box, "the goal", lambda goal: not self.goal_rule.success(start, goal))
        x, y, z = self.goal.tolist()
        self._marker.place((x, y, z))
