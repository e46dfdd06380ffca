"""Experiments with their runs: pages of them, their curves, and the densities of their success ratios.

Without a filter, all columns of only one page are read.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from math import inf
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np
from sqlalchemy import select

from ..errors import StoreError, UsageError, alternatives
from ..records.run_records import RunSummary
from .density import Density, kde
from .store import Store, summaries
from .tables import RUNS, SPECS, SUCCESSES, TESTS, put

ORDERS = ("created", "name", "success_end", "mean_return", "steps", "seconds")
"""Sort keys of experiments: means over their finished runs, and the time of the newest run."""
SMALLEST_FIRST = ("name", "steps", "seconds")


@dataclass(frozen=True)
class ExperimentPage:
    """Some of the experiments that match a filter."""

    experiments: tuple[tuple[RunSummary, ...], ...]
    """The matching runs of each experiment, newest first."""
    total: int
    """Number of matching experiments on all pages."""


class CurvePoint(NamedTuple):
    """One test of a run."""

    steps: int
    success_end: float | None
    mean_return: float | None


def find_experiments(
    store: Store,
    where: str | None = None,
    *,
    trials: bool = False,
    order: str = "created",
    offset: int = 0,
    limit: int = 50,
) -> ExperimentPage:
    """Up to `limit` experiments after the first `offset` that have runs which match a filter, as for `Store.runs`.

    They are sorted by one of ORDERS; those without a value come last. Runs of sweeps' trials count only with `trials`.

    Raises UsageError if the order is unknown, or the filter cannot be read or names what no run has.
    """
    if order not in ORDERS:
        raise UsageError(f"experiments cannot be sorted by {order!r}", hint=alternatives(order, ORDERS, what="orders"))
    kept = None if where is None else store.matching(where)
    query = select(*{RUNS.c[name] for name in ("run", "experiment", "state", order)})
    query = query.order_by(RUNS.c.created.desc(), RUNS.c.run.desc())
    if not trials:
        query = query.where(~RUNS.c.trial)
    matching: dict[str, list[tuple[str, bool, Any]]] = defaultdict(list)
    with store.reading() as connection:
        for row in connection.execute(query):
            if kept is None or row.run in kept:
                matching[row.experiment].append((row.run, row.state == "finished", getattr(row, order)))
        ranks = {experiment: _rank(_values(runs), order) for experiment, runs in matching.items()}
        chosen = islice(sorted(matching, key=ranks.__getitem__), offset, offset + limit)
        wanted = {run: experiment for experiment in chosen for run, *_ in matching[experiment]}
        newest = select(RUNS).where(RUNS.c.run.in_(wanted)).order_by(RUNS.c.created.desc(), RUNS.c.run.desc())
        found = summaries(connection, newest, store.home)
    groups: dict[str, list[RunSummary]] = {experiment: [] for experiment in wanted.values()}
    for run in found:
        groups[wanted[run.run]].append(run)
    return ExperimentPage(tuple(map(tuple, filter(None, groups.values()))), len(matching))


def curves(store: Store, runs: Sequence[str]) -> dict[str, list[CurvePoint]]:
    """The tests of some runs in the order of their steps, without their measures."""
    columns = TESTS.c
    query = select(columns.run, columns.steps, columns.successes_end, columns.episodes, columns.mean_return)
    found: dict[str, list[CurvePoint]] = defaultdict(list)
    for run, steps, successes, episodes, mean in store.fetch(
        query.where(columns.run.in_(runs)).order_by(columns.run, columns.steps)
    ):
        found[run].append(CurvePoint(steps, None if successes is None or not episodes else successes / episodes, mean))
    return dict(found)


def steps_asked(store: Store, runs: Sequence[str]) -> dict[str, int]:
    """The environment steps in the specs of some runs."""
    query = select(RUNS.c.run, SPECS.c.content).join(SPECS).where(RUNS.c.run.in_(runs))
    asked = {run: (spec.get("training") or {}).get("steps") for run, spec in store.fetch(query)}
    return {run: steps for run, steps in asked.items() if isinstance(steps, int) and steps > 0}


def _values(runs: Sequence[tuple[str, bool, Any]]) -> list[Any]:
    """The values of the finished runs; of all if none is finished."""
    return [value for _, finished, value in runs if finished] or [value for *_, value in runs]


def _rank(values: Sequence[Any], order: str) -> Any:
    """A key that sorts experiments by the values of their runs: newest first, or best or smallest mean first."""
    if order == "name":
        return values[0]
    if order == "created":
        return 0  # they come in this order
    known = [value for value in values if value is not None]
    if not known:
        return inf
    return fmean(known) if order in SMALLEST_FIRST else -fmean(known)


def success_densities(
    store: Store | None,
    experiment: str,
    counting: str,
    ratios: Mapping[float, Sequence[float]],
    *,
    reported: bool = False,
) -> tuple[Density, ...]:
    """The density of the success ratios at each step. New densities are stored in the database.

    A stored density is used if its ratios are the same. If the database cannot be written, the numbers do not change;
    without a store every density is computed.

    `counting` is any or end, `ratios` maps environment steps of training to the success ratio of each run. If
    `reported`, they are the reported ratios of the runs, not those of a test during training.
    """
    key = {"experiment": experiment, "counting": counting, "reported": reported}
    query = select(SUCCESSES).where(*(SUCCESSES.c[name] == value for name, value in key.items()))
    stored = {} if store is None else {row.steps: row for row in store.fetch(query)}
    found, new = [], []
    for steps, values in ratios.items():
        row = stored.get(steps)
        if row is not None and row.ratios == list(values):
            numbers = {name: getattr(row, name) for name in ("bandwidth", "mode", "mean", "low", "high")}
            heights = np.array(row.density)
            grid = np.linspace(0, 1, heights.size)
            found.append(Density(grid=grid, density=heights, modes=tuple(row.modes), **numbers))
            continue
        found.append(kde(values))
        lists = {"density": found[-1].density.tolist(), "modes": list(found[-1].modes), "ratios": list(values)}
        numbers = {name: value for name, value in vars(found[-1]).items() if name != "grid"}
        new.append(numbers | lists | key | {"steps": steps, "runs": len(values)})
    if store is not None and new:
        with suppress(StoreError), store.writing() as connection:
            put(connection, SUCCESSES, new)
    return tuple(found)
