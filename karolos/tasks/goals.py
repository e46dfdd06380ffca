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
