"""How the success ratios of an experiment's runs are spread, test by test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from sqlalchemy import Connection, select

from ..statistics.density import kde
from .connection import ReadOnlyError
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
        runs: how many were tested after these steps.
        bandwidth: standard deviation of the kernel.
        mode: where the density is largest.
        modes: its local maxima.
        mean: of the density.
        low: 5 % of the mass lie below.
        high: 95 % of the mass lie below.
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
    """How the success ratios of an experiment's runs are spread, in the order of steps; `any` before `end`.

    Computed when asked for and then kept in the database until a test or a run of the experiment comes or goes. A
    database that may only be read gives them, too.
    """
    with store.reading() as connection:
        found = _stored(connection, experiment)
    if found:
        return found
    try:
        with store.writing() as connection:
            forget_summaries(connection, [experiment])
            found = _computed(connection, experiment)
            put(connection, SUCCESSES, [vars(one) | {"modes": list(one.modes)} for one in found])
    except ReadOnlyError:
        with store.reading() as connection:
            found = _computed(connection, experiment)
    return found


def _stored(connection: Connection, experiment: str) -> tuple[SuccessSummary, ...]:
    """The summaries that stand in the database, in order of steps."""
    found = SUCCESSES.c
    query = select(SUCCESSES).where(found.experiment == experiment).order_by(found.steps, found.counting)
    return tuple(SuccessSummary(**{**row._mapping, "modes": tuple(row.modes)}) for row in connection.execute(query))


def _computed(connection: Connection, experiment: str) -> tuple[SuccessSummary, ...]:
    """The summaries of the tests that stand in the database, in order of steps."""
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
            ratios = [getattr(row, f"successes_{counting}") / row.episodes for row in rows]
            found.append(_summary(experiment, steps, counting, ratios))
    return tuple(found)


def _summary(experiment: str, steps: int, counting: str, ratios: Sequence[float]) -> SuccessSummary:
    density = kde(ratios)
    return SuccessSummary(
        experiment,
        steps,
        counting,
        len(ratios),
        bandwidth=density.bandwidth,
        mode=density.mode,
        modes=density.modes,
        mean=density.mean,
        low=density.low,
        high=density.high,
    )
