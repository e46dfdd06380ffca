"""Success under changed settings: what `karolos test` recorded of the runs of an experiment."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from ..core.seeding import SeedTree
from ..errors import KarolosError
from ..records import RunFolder, transfer_results
from ..records.results import TestCounts
from ..statistics import aggregates
from .contenders import Contender
from .scores import Estimate, estimate


def conditions(contender: Contender, tree: SeedTree) -> dict[str, dict[float, Estimate]]:
    """For each setting that tests gave other numbers: success at the end of the episode at each of them, ascending.

    A test counts if it changed this setting alone. The run's own value stands among the others, with the success on the
    same episodes. Of two tests at the same value the later one counts.
    """
    tested: dict[str, dict[float, dict[int, TestCounts]]] = {}
    for place, run in enumerate(contender.runs):
        with suppress(KarolosError):  # the folder is gone or damaged, and the index does not hold these tests
            for test in transfer_results.read(RunFolder.open(run.summary.folder))[0]:
                setting, _, text = test.overrides[0].partition("=") if len(test.overrides) == 1 else ("", "", "")
                value, own = _number(text), _number(_setting(run.spec, setting))
                if value is not None and own is not None and not test.randomized:
                    at = tested.setdefault(setting, {})
                    at.setdefault(own, {})[place] = test.own
                    at.setdefault(value, {})[place] = TestCounts.of(test.result)
    found: dict[str, dict[float, Estimate]] = {}
    for setting, values in sorted(tested.items()):
        for value, runs in sorted(values.items()):
            ends = [(one.successes_end or 0) / one.episodes for one in runs.values()]
            episodes = next(iter(runs.values())).episodes
            one = estimate([ends], aggregates.mean, tree.child(setting, f"{value:g}"), episodes)
            if one is not None:
                found.setdefault(setting, {})[value] = one
    return found


def _setting(spec: Mapping[str, Any], path: str) -> Any:
    value: Any = spec
    for key in path.split("."):
        value = value.get(key) if isinstance(value, Mapping) else None
    return value


def _number(value: Any) -> float | None:
    """A finite number; None for anything else."""
    try:
        number = float(value) if not isinstance(value, bool) else math.nan
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None
