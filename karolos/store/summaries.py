"""The densities of the success ratios of an experiment's runs, which comparisons and their figures show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from sqlalchemy import select

from ..errors import StoreError
from ..statistics.density import Density, kde
from .rows import put
from .store import Store
from .tables import SUCCESSES


def success_densities(
    store: Store | None,
    experiment: str,
    counting: str,
    ratios: Mapping[float, Sequence[float]],
    *,
    reported: bool = False,
) -> tuple[Density, ...]:
    """The density of the success ratios at each step; the database keeps what it does not have yet.

    A stored density is used if it is of the same ratios. A database that cannot be written changes no number.

    Args:
        store: None computes every density.
        experiment: hash.
        counting: any or end.
        ratios: environment steps of training -> success ratio of each run.
        reported: whether these are the ratios that the runs report, not those of a test on the way.
    """
    key = {"experiment": experiment, "counting": counting, "reported": reported}
    stored = {} if store is None else _stored(store, key)
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
        with suppress(StoreError), store.database.writing() as connection:
            put(connection, SUCCESSES, new)
    return tuple(found)


def _stored(store: Store, key: Mapping[str, Any]) -> dict[float, Any]:
    columns = SUCCESSES.c
    query = select(SUCCESSES).where(*(columns[name] == value for name, value in key.items()))
    return {row.steps: row for row in store.database.fetch(query)}
