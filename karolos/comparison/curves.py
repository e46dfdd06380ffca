"""Learning curves of several seeds: interpolated at common points, their statistics, and their densities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..core.seeding import Generator
from ..records.intervals import wilson
from ..records.run_records import Metric, RunRecord, Success
from ..store import Store
from ..store.density import Density
from ..store.experiments import success_densities
from . import aggregates
from .contenders import Contender

Axis = Literal["steps", "seconds"]
POINTS = 101
"""Largest number of points of a curve over seeds that were tested at different steps."""

_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Curve:
    """A statistic of the success or return of all seeds over training.

    Args:
        at: (t,) environment steps or seconds, ascending.
        middle: (t,) the statistic at each.
        low: (t,) lower end of the band.
        high: (t,) upper end.
    """

    at: _Floats
    middle: _Floats
    low: _Floats
    high: _Floats


def places(run: RunRecord, axis: Axis) -> _Floats:
    """Steps or seconds of a run's tests: (t,)."""
    return np.array([getattr(test, axis) for test in run.tests], float)


def along(runs: Sequence[RunRecord], axis: Axis, metric: Metric) -> tuple[_Floats, _Floats]:
    """Success ratios or mean returns of all seeds at common points: (t,) and (t, n).

    The points begin at the first test of the seed that was tested last, and end at the earliest end of an unfinished
    run. A finished run keeps its last value. Values between a seed's tests are interpolated linearly. If all seeds were
    tested at the same steps, the points are these steps, and nothing is interpolated.
    """
    own = [places(run, axis) for run in runs]
    values = [run.values(metric) for run in runs]
    start = max(at[0] for at in own)
    open_ends = [at[-1] for at, run in zip(own, runs, strict=True) if not run.finished]
    end = max(min(open_ends) if open_ends else max(at[-1] for at in own), start)
    points = np.unique(np.concatenate([at[(at >= start) & (at <= end)] for at in own]))
    if axis == "seconds" or points.size > POINTS:
        points = np.linspace(start, end, POINTS) if end > start else np.array([start])
    return points, np.stack([np.interp(points, *pair) for pair in zip(own, values, strict=True)], axis=1)


def learning_curve(
    runs: Sequence[RunRecord], axis: Axis, metric: Metric, statistic: aggregates.Statistic, generator: Generator
) -> Curve:
    """A statistic over the seeds with its band: Wilson's for one run, the range for 2 - 4, else bootstrap (95 %).

    The band of one run's return has no width.
    """
    at, values = along(runs, axis, metric)
    middle = statistic(values)
    found = aggregates.band(values, statistic, generator)
    if found is not None:
        low, high = found
    elif len(runs) > 1 or metric == "return":
        low, high = values.min(axis=1), values.max(axis=1)
    else:
        ends = [
            wilson(round(value * test.episodes), test.episodes)
            for value, test in zip(runs[0].values(metric), runs[0].tests, strict=True)
        ]
        low, high = (np.interp(at, places(runs[0], axis), [pair[side] for pair in ends]) for side in (0, 1))
    return Curve(at, middle, low, high)


def densities(
    contender: Contender, success: Success, store: Store | None = None
) -> tuple[_Floats, tuple[Density, ...]]:
    """Density over the seeds at each common test point, from the store: environment steps (t,) and t densities."""
    at, values = along(contender.runs, "steps", success)
    ratios = dict(zip(at.tolist(), values.tolist(), strict=True))
    return at, success_densities(store, contender.experiment, success, ratios)
