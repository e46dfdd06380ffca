"""Goal rules: pure, vectorised over leading axes, picklable."""

from __future__ import annotations

import numpy as np

from ..core import Array, BoolArray, FloatArray, GoalRule


class NearGoal(GoalRule):
    """Success where the distance of `achieved` (..., 3) from `desired` (..., 3) is under `threshold`, in m.

    Reward, sparse: 0 there, else -1. Dense: minus the distance in m.

    Args:
        span: the largest distance that can occur, in m; bounds the dense reward.
    """

    def __init__(self, threshold: float, *, dense: bool, span: float) -> None:
        self.threshold = threshold
        self.dense = dense
        self.reward_range = (-span, 0.0) if dense else (-1.0, 0.0)
        self._squared = np.float32(threshold**2)

    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        away = achieved - desired
        squared = np.vecdot(away, away)
        if self.dense:
            distance: FloatArray = -np.sqrt(squared, dtype=np.float32)
            return distance
        missed: FloatArray = -np.asarray(squared >= self._squared, np.float32)
        return missed

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        away = achieved - desired
        near: BoolArray = np.vecdot(away, away) < self._squared
        return near

    def distance(self, achieved: Array, desired: Array) -> FloatArray:
        away = achieved - desired
        metres: FloatArray = np.sqrt(np.vecdot(away, away), dtype=np.float32)
        return metres


class StagedPick(NearGoal):
    """Reward in [-1, 0] for reaching, grasping, lifting and bringing an object: the mean of four stages, less 1.

    A function of the state alone: what an arm gains by coming nearer it loses by leaving. `achieved` (..., 7) is the
    object's position (3), the tool's (3), both in m, and the share of pads in contact; `desired` (..., 3).

    * reach: 1 - tanh(5 d), d from tool to object in m
    * grasp: share of pads in contact
    * lift: share of the goal's height above the surface; 1 for a goal on the surface
    * bring: 1 - tanh(5 d), d from object to goal
    Where the goal is reached, the reward is 0.

    Args:
        rest: height in m of an object on the surface.
    """

    def __init__(self, threshold: float, *, rest: float) -> None:
        super().__init__(threshold, dense=True, span=1.0)
        self.rest = rest

    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        thing, tool, pads = achieved[..., :3], achieved[..., 3:6], achieved[..., 6]
        away, short = tool - thing, thing - desired
        reach = 1 - np.tanh(5 * np.sqrt(np.vecdot(away, away)))
        bring = 1 - np.tanh(5 * np.sqrt(np.vecdot(short, short)))
        height = desired[..., 2] - self.rest
        raised = np.clip((thing[..., 2] - self.rest) / np.maximum(height, 1e-3), 0, 1)
        lift = np.where(height < self.threshold, 1.0, raised)
        staged = (reach + pads + lift + bring) / 4 - 1
        worth: FloatArray = np.where(self.success(achieved, desired), 0.0, np.clip(staged, -1, 0)).astype(np.float32)
        return worth

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        return super().success(achieved[..., :3], desired)

    def distance(self, achieved: Array, desired: Array) -> FloatArray:
        return super().distance(achieved[..., :3], desired)


class Landing(GoalRule):
    """Success where a thrown object lands nearer than `threshold` to the target, in m; landing ends the episode.

    `achieved` (..., 3) is the object's place along the floor (2) in m and a status: 0 in the hand or in the air, 1
    landed after a release, -1 on the floor without one. `desired` (..., 2) is the target in m.

    Reward, sparse: 1 for a success, else 0; a price per step would make dropping the object at once pay. Dense: for
    landing after a release 1 - tanh(2 d), d in m from the target; else 0.
    """

    reward_range = (0.0, 1.0)

    def __init__(self, threshold: float, *, dense: bool) -> None:
        self.threshold = threshold
        self.dense = dense

    def distance(self, achieved: Array, desired: Array) -> FloatArray:
        away = achieved[..., :2] - desired
        missed: FloatArray = np.where(achieved[..., 2] > 0.5, np.sqrt(np.vecdot(away, away)), np.inf).astype(np.float32)
        return missed

    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        if self.dense:
            worth: FloatArray = (1 - np.tanh(2 * self.distance(achieved, desired))).astype(np.float32)
            return worth
        return self.success(achieved, desired).astype(np.float32)

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        near: BoolArray = self.distance(achieved, desired) < self.threshold
        return near

    def terminated(self, achieved: Array, desired: Array) -> BoolArray:  # noqa: ARG002 (a landing is one anywhere)
        landed: BoolArray = np.abs(achieved[..., 2]) > 0.5
        return landed
