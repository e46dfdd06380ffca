"""Statistics over seeds: pure functions of arrays. The seed is the unit; episodes are never pooled over seeds.

Sources: Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the Statistical Precipice" (inter-quartile
mean, stratified bootstrap, probability of improvement, performance profiles); the coverage of small samples is in
`reliability`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.seeding import Generator

_Floats = NDArray[np.float64]
Statistic = Callable[[_Floats], _Floats]
"""A number for each row: values (..., n) to (...)."""
RESAMPLES = 2000
LEVELS = ((1 - 0.95) / 2, (1 + 0.95) / 2)
"""Quantiles at the ends of a 95 % interval."""
FEW_SEEDS = 5
"""Fewest seeds with a bootstrap interval."""
MOST_UNKNOWN = LEVELS[0]
"""Largest share of resamples without a value: with more, an end of the interval could be any of theirs."""


def mean(values: ArrayLike) -> _Floats:
    """Over the last axis: (..., n) to (...)."""
    return np.asarray(np.mean(np.asarray(values, float), axis=-1))


def iqm(values: ArrayLike) -> _Floats:
    """Inter-quartile mean over the last axis: (..., n) to (...). A quarter, rounded down, is left out at each end.

    nan where a value is.
    """
    ordered = np.sort(np.asarray(values, float), axis=-1)  # nan last
    cut = ordered.shape[-1] // 4
    middle = ordered[..., cut : ordered.shape[-1] - cut].mean(axis=-1)
    return np.where(np.isnan(ordered[..., -1]), np.nan, middle)


def reliability(seeds: int) -> Literal["none", "approximate", "usual"]:
    """How reliable a bootstrap interval over this number of seeds is.

    A nominal 95 % interval of the mean covered the truth in 61 % of cases with 3 seeds, 77 % with 5 and 93 % with 10
    (one simulated bimodal case): below 5 there is no interval, below 10 it is approximate.
    """
    return "none" if seeds < FEW_SEEDS else "approximate" if seeds < 10 else "usual"


def paired_interval(
    rows: Sequence[ArrayLike], statistic: Callable[..., _Floats], generator: Generator
) -> tuple[float, float] | None:
    """95 % percentile bootstrap interval of a statistic of one or several values per seed: rows (n,) each.

    The rows' seeds are drawn together. An end is the value of a resample, which may be infinite. None for fewer than 5
    seeds, and where more than 2.5 % of the resamples are nan; up to that they are left out.
    """
    table = np.asarray(rows, float)
    seeds = table.shape[-1]
    if reliability(seeds) == "none":
        return None
    drawn = generator.integers(0, seeds, (RESAMPLES, seeds))
    found = statistic(*(row[drawn] for row in table))
    known = found[~np.isnan(found)]
    if known.size < (1 - MOST_UNKNOWN) * RESAMPLES:
        return None
    low, high = np.quantile(known, LEVELS, method="inverted_cdf")  # interpolation would make nan of two infinite ones
    return float(low), float(high)


def band(values: ArrayLike, statistic: Statistic, generator: Generator) -> tuple[_Floats, _Floats] | None:
    """As `paired_interval`, at each of several points: values (t, n) to low and high (t,); None for fewer than 5 seeds.

    A resample draws whole seeds, the same ones at every point, as a run is drawn as a whole.
    """
    table = np.asarray(values, float)
    seeds = table.shape[-1]
    if reliability(seeds) == "none":
        return None
    drawn = generator.integers(0, seeds, (RESAMPLES, seeds))
    low, high = np.quantile(np.stack([statistic(row[drawn]) for row in table]), LEVELS, axis=1)
    return low, high


def improvement(ours: ArrayLike, theirs: ArrayLike) -> float:
    """Probability that a run of ours is better than one of theirs; ties count one half. Values (n,) and (m,)."""
    return float(_improvements(np.asarray(ours, float), np.asarray(theirs, float)))


def improvement_interval(ours: ArrayLike, theirs: ArrayLike, generator: Generator) -> tuple[float, float] | None:
    """95 % bootstrap interval of `improvement`, seeds of both sides resampled; None for fewer than 5 on a side."""
    one, other = np.asarray(ours, float), np.asarray(theirs, float)
    if "none" in {reliability(one.size), reliability(other.size)}:
        return None
    drawn = one[generator.integers(0, one.size, (RESAMPLES, one.size))]
    against = other[generator.integers(0, other.size, (RESAMPLES, other.size))]
    low, high = np.quantile(_improvements(drawn, against), LEVELS)
    return float(low), float(high)


def _improvements(ours: _Floats, theirs: _Floats) -> _Floats:
    """`improvement` over the last axis: (..., n) and (..., m) to (...)."""
    signs = np.sign(ours[..., :, None] - theirs[..., None, :])
    return np.asarray((signs.mean(axis=(-2, -1)) + 1) / 2)


def profile(values: ArrayLike, thresholds: ArrayLike) -> _Floats:
    """Performance profile: the fraction of seeds whose value (n,) is at least each threshold (t,): (t,)."""
    return np.asarray((np.asarray(values, float)[None] >= np.asarray(thresholds, float)[:, None]).mean(axis=1))
