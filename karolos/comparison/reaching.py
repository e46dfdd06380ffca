"""Times at which runs first reach a threshold; some runs end before they reach it.

Source: Kaplan and Meier 1958, J. Am. Stat. Assoc. 53, 457.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Floats = NDArray[np.float64]


def first_reaching(ratios: Sequence[float], at: Sequence[float], threshold: float) -> float | None:
    """Steps or seconds at which a run's test ratio first is `threshold` or more; None: never (censored)."""
    return next((place for ratio, place in zip(ratios, at, strict=True) if ratio >= threshold), None)


def kaplan_meier(times: ArrayLike, reached: ArrayLike) -> tuple[_Floats, _Floats]:
    """Kaplan-Meier estimate of the fraction of runs that have not reached a threshold yet.

    At each time t at which d of r observed runs reach it, the fraction is multiplied by 1 - d / r. `times` (..., n) are
    the steps at which each run reached it or ended, `reached` (..., n) whether it did; otherwise it is censored.

    Returns the times in ascending order (of equal ones those of reaching first) and the fraction after each: (..., n).
    """
    steps, events = np.asarray(times, float), np.asarray(reached, bool)
    order = np.lexsort((~events, steps), axis=-1)
    ordered = np.take_along_axis(steps, order, axis=-1)
    at_risk = np.arange(steps.shape[-1], 0, -1)
    factors = np.where(np.take_along_axis(events, order, axis=-1), 1 - 1 / at_risk, 1.0)
    return ordered, np.multiply.accumulate(factors, axis=-1)


def median_time(times: ArrayLike, reached: ArrayLike) -> _Floats:
    """Kaplan-Meier median: the first time at which more than half of the runs have reached the threshold.

    (..., n) to (...). If exactly half of the runs have reached it until the next one does, the result is the middle of
    these two times, which is the mean of the two middle runs of an even number. inf if there is no next run, or if the
    estimate stays above one half.
    """
    ordered, remaining = kaplan_meier(times, reached)

    def first(at: NDArray[np.bool_]) -> _Floats:
        found = np.take_along_axis(ordered, at.argmax(axis=-1)[..., None], axis=-1)[..., 0]
        return np.where(at.any(axis=-1), found, np.inf)

    return np.asarray((first(remaining <= 0.5 + 1e-12) + first(remaining < 0.5 - 1e-12)) / 2)


def median_reaching(places: Sequence[float | None]) -> float | None:
    """Median over seeds of the steps or seconds to a threshold; a seed that never reached it counts as infinite.

    It equals `median_time` if all runs are equally long, and is larger if one was aborted. None if it is infinite or
    there are no seeds.
    """
    if not places:
        return None
    middle = float(median(math.inf if place is None else place for place in places))
    return middle if math.isfinite(middle) else None
