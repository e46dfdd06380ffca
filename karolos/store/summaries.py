"""The distribution of the success ratios of an experiment's runs, test by test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from sqlalchemy import Connection, select

from ..statistics.density import kde
from .database import ReadOnlyError
from .rows import put
from .store import Store
from .tables import RUNS, SUCCESSES, TESTS
from .writing import forget_summaries


@dataclass(frozen=True)
class SuccessSummary:
    """The density of the success ratios after `steps`, one ratio per run (`statistics.kde`).

    Args:
        experiment: hash.
        steps: environment steps of training before the test.
        counting: any or end.
        runs: number of runs that were tested after these steps.
        bandwidth: standard deviation of the kernel.
        mode: where the density is largest.
        modes: its local maxima.
        mean: of the density.
        low: 5 % quantile.
        high: 95 % quantile.
    """

    experiment: str
    steps: int
    counting: str
    runs: int
    bandwidth: float
    mode: float
    modes: tuple[float, ...]
    mean: float
    low: float
    high: float


def success_summaries(store: Store, experiment: str) -> tuple[SuccessSummary, ...]:
    """The summaries of an experiment's tests, in the order of steps; `any` before `end`.

    They are computed on demand and stored in the database until a test or a run of the experiment is added or removed.
    In a read-only database they are computed each time.
    """
    with store.database.reading() as connection:
        found = _stored(connection, experiment)
    if found:
        return found
    try:
        with store.database.writing() as connection:
            forget_summaries(connection, [experiment])
            found = _computed(connection, experiment)
            put(connection, SUCCESSES, [vars(one) | {"modes": list(one.modes)} for one in found])
    except ReadOnlyError:
        with store.database.reading() as connection:
            found = _computed(connection, experiment)
    return found


def _stored(connection: Connection, experiment: str) -> tuple[SuccessSummary, ...]:
    columns = SUCCESSES.c
    query = select(SUCCESSES).where(columns.experiment == experiment).order_by(columns.steps, columns.counting)
    return tuple(SuccessSummary(**{**row._mapping, "modes": tuple(row.modes)}) for row in connection.execute(query))


def _computed(connection: Connection, experiment: str) -> tuple[SuccessSummary, ...]:
    tests = TESTS.c
    query = (
        select(tests.steps, tests.successes_any, tests.successes_end, tests.episodes)
        .join(RUNS, RUNS.c.run == tests.run)
        .where(RUNS.c.experiment == experiment)
        .order_by(tests.steps, RUNS.c.created, RUNS.c.run)
    )
    found = []
    for steps, group in groupby(connection.execute(query), key=lambda row: row.steps):
        rows: Sequence[Any] = list(group)
        for counting in ("any", "end"):
            density = kde([getattr(row, f"successes_{counting}") / row.episodes for row in rows])
            facts = {name: getattr(density, name) for name in ("bandwidth", "mode", "modes", "mean", "low", "high")}
            found.append(SuccessSummary(experiment, steps, counting, len(rows), **facts))
    return tuple(found)
