"""A point moves to a goal point: no physics, so that tests and first steps take seconds."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field as Setting

from ..core import Array, BoolArray, Environment, Field, FloatArray, GoalRule, Layout, Measure, Signature, Step
from ..core import Settings as BaseSettings


class NearPoint(GoalRule):
    """Success within `threshold` of the goal; reward 0 there, else -1 (sparse), or minus the distance (dense)."""

    def __init__(self, threshold: float, *, dense: bool, diameter: float) -> None:
        self.threshold = threshold
        self.dense = dense
        self.reward_range = (-diameter, 0.0) if dense else (-1.0, 0.0)

    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        distance = _distance(achieved, desired)
        return np.negative(distance) if self.dense else np.subtract(distance < self.threshold, 1, dtype=np.float32)

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        return np.asarray(_distance(achieved, desired) < self.threshold)


def _distance(achieved: Array, desired: Array) -> FloatArray:
    between = np.subtract(achieved, desired, dtype=np.float32)
    distance: FloatArray = np.sqrt(np.add.reduce(between * between, axis=-1))  # three times as fast as norm()
    return distance


def _unit(values: Array) -> FloatArray:
    """Values clipped to [-1, 1]; twice as fast as `np.clip` for a few values."""
    return np.minimum(np.maximum(values, -1, dtype=np.float32), 1)


class Toy(Environment):
    """What to do: move a point in the cube [-1, 1]^dimensions to a goal point.

    What is randomised: start and goal, uniformly in the cube, never solved at reset.

    Observation: position (dimensions).
    Action: displacement (dimensions) in units of `speed`.
    Goals: achieved, the position; desired, the goal (dimensions).
    Reward: sparse -1 until the goal is reached, then 0; dense minus the distance.
    What counts as success: the point lies within `threshold` of the goal.
    Termination: never; the episode is truncated after `max_steps`.
    Measures: the distance from the goal at the end.
    """

    class Settings(BaseSettings):
        dimensions: int = Setting(2, ge=1, le=16, description="dimensions of the space in which the point moves")
        threshold: float = Setting(0.1, gt=0, lt=1, description="distance at which the goal is reached")
        speed: float = Setting(0.2, gt=0, le=2, description="largest displacement per step along each axis")
        max_steps: int = Setting(20, ge=1, le=100_000, description="steps per episode")
        reward: Literal["sparse", "dense"] = Setting("sparse", description="-1 until success, or minus the distance")

    def __init__(self, settings: Toy.Settings) -> None:
        self.settings = settings
        size = settings.dimensions
        rule = NearPoint(settings.threshold, dense=settings.reward == "dense", diameter=2 * size**0.5)
        self.signature = Signature(
            observation=Layout((Field("position", size),)),
            action=Layout((Field("displacement", size),)),
            max_steps=settings.max_steps,
            reward_range=rule.reward_range,
            achieved_goal=Layout((Field("position", size),)),
            desired_goal=Layout((Field("goal", size),)),
            goal_rule=rule,
            measures=(Measure("final_distance", "1", "smaller", "distance from the goal at the end of the episode"),),
        )
        self._rule = rule
        self._speed = np.float32(settings.speed)
        self._steps = settings.max_steps  # no episode is running

    def reset(self, seed: int) -> Step:
        generator = np.random.Generator(np.random.PCG64(seed))
        size = self.settings.dimensions
        self._position = generator.uniform(-1, 1, size).astype(np.float32)
        self._goal = generator.uniform(-1, 1, size).astype(np.float32)
        while self._rule.success(self._position, self._goal):
            self._goal = generator.uniform(-1, 1, size).astype(np.float32)
        self._steps = 0
        return self._step(0.0, truncated=False)

    def step(self, action: Array) -> Step:
        if self._steps >= self.settings.max_steps:
            raise RuntimeError("the episode is over; reset the environment first")
        displacement = _unit(action) * self._speed
        self._position = _unit(self._position + displacement)
        self._steps += 1
        reward = float(self._rule.reward(self._position, self._goal))
        return self._step(reward, truncated=self._steps >= self.settings.max_steps)

    def _step(self, reward: float, *, truncated: bool) -> Step:
        success = bool(self._rule.success(self._position, self._goal))
        return Step(self._position, self._position, self._goal, reward, False, truncated, success)

    def measures(self) -> FloatArray:
        return np.array([_distance(self._position, self._goal)], np.float32)

    def render(self, width: int = 640, height: int = 480) -> np.ndarray:
        """The first two axes: the goal as a green disc, the point as a blue one."""
        picture = np.full((height, width, 3), 255, np.uint8)
        rows, columns = np.mgrid[0:height, 0:width]
        scale = min(width, height) / 2.4
        for place, radius, colour in (
            (self._goal, max(self.settings.threshold, 0.03), (80, 170, 90)),
            (self._position, 0.03, (40, 80, 200)),
        ):
            across = place[0] * scale + width / 2
            down = height / 2 - (place[1] * scale if place.size > 1 else 0)
            picture[(columns - across) ** 2 + (rows - down) ** 2 <= (radius * scale) ** 2] = colour
        return picture
