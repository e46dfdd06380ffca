"""Metrics of transfer: pure functions of arrays. The last axis holds the paired seeds; leading axes are resamples.

Sources: Taylor and Stone 2009, "Transfer Learning for Reinforcement Learning Domains: A Survey", JMLR 10, 1633
(jump-start, asymptotic performance, time to threshold); Wolczyk et al. 2021, "Continual World: A Robotic Benchmark For
Continual Reinforcement Learning" (forward transfer).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..comparison.aggregates import mean
from ..comparison.reaching import median_time

_Floats = NDArray[np.float64]


def ratio_of_means(values: ArrayLike, baseline: ArrayLike) -> _Floats:
    """Mean of the values divided by the mean of the baseline, (..., n) each to (...); nan if that is 0."""
    above, below = mean(values), mean(baseline)
    return np.divide(above, below, out=np.full_like(above, np.nan), where=below > 0)


def forward_transfer(areas: ArrayLike, scratch: ArrayLike) -> _Floats:
    """Forward transfer (AUC - AUC_scratch) / (1 - AUC_scratch) of mean areas, (..., n) each to (...).

    1: success from the first test on; 0: no gain over training from scratch; negative: worse than from scratch; nan if
    training from scratch leaves nothing to gain. Source: Wolczyk et al. 2021, section 4.
    """
    tuned, baseline = mean(areas), mean(scratch)
    return np.divide(tuned - baseline, 1 - baseline, out=np.full_like(tuned, np.nan), where=baseline < 1)


def area_under_curve(at: ArrayLike, values: ArrayLike, start: float, end: float) -> float:
    """Mean of a learning curve between two steps, in [0, 1] for success ratios.

    Args:
        at: (t,) ascending steps of the tests.
        values: (t,) success ratios; straight lines between them, constant before the first and after the last.
        start: first step.
        end: last step; if it is `start`, the value there is returned.
    """
    steps, ratios = np.asarray(at, float), np.asarray(values, float)
    points = np.unique(np.concatenate([[start, end], steps[(steps > start) & (steps < end)]]))
    heights = np.interp(points, steps, ratios)
    return float(np.trapezoid(heights, points) / (end - start)) if end > start else float(heights[0])


def median_time_ratio(times: ArrayLike, reached: ArrayLike, scratch: ArrayLike, scratch_reached: ArrayLike) -> _Floats:
    """Median time to threshold divided by that of training from scratch, (..., n) each to (...).

    inf if the first is infinite, 0 if that from scratch is infinite, nan if both are.
    """
    tuned, baseline = median_time(times, reached), median_time(scratch, scratch_reached)
    with np.errstate(invalid="ignore"):  # inf / inf
        return np.asarray(tuned / baseline)
