"""Generalised advantage estimation (Schulman et al. 2016, arXiv 1506.02438)."""

from __future__ import annotations

import numpy as np

from ..core import FloatArray, Rollout


def advantages(
    rollout: Rollout, value: FloatArray, next_value: FloatArray, *, discount: float, trace_decay: float
) -> FloatArray:
    """How much better each action was than what the policy does on average, (T, n); 0 where nothing is stored.

    A_t = d_t + discount * trace_decay * A_(t+1), with d_t = reward + discount * value(s') - value(s). Nothing lies
    beyond a terminated step. Beyond a truncated one, and beyond the rollout's last, lies the value of where it led; the
    sum ends there, because what follows is of another episode.

    Args:
        rollout: rewards and ends.
        value: of the observations, (T, n).
        next_value: of the next observations, (T, n).
        discount: of the next step's value.
        trace_decay: lambda; 0 trusts the values, 1 the rewards.
    """
    beyond = np.where(rollout.terminated, np.float32(0), next_value)
    difference = np.where(rollout.stored, rollout.reward + np.float32(discount) * beyond - value, np.float32(0))
    decay = np.where(rollout.ended, np.float32(0), np.float32(discount * trace_decay))
    found = np.zeros_like(difference)
    after = np.zeros_like(difference[0])
    for step in reversed(range(len(found))):
        after = found[step] = difference[step] + decay[step] * after
    return found
