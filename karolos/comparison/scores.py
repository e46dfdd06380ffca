"""The numbers of a comparison. The seed is the unit: a run gives one number, an experiment one per seed.

A run's success is that of its final test, whose episodes nothing was chosen on; without one, of its last test.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from ..core.seeding import SeedTree
from ..statistics import aggregates
from ..statistics import density as statistics
from ..statistics.intervals import wilson
from ..store.rows import without_seeds
from .cautions import cautions
from .contenders import ComparedRun, Contender, Success
from .curves import places
from .differences import MISSING, differences

IntervalKind = Literal["wilson", "range", "approximate", "bootstrap"]
"""Kind of an interval: Wilson's of one run; smallest to largest of 2 - 4 seeds; bootstrap over 5 - 9 seeds, which
covers too little; bootstrap over 10 or more seeds. All but the range are at 95 %."""
RATIOS = (0.5, 0.9)
"""Success ratios (`end` by default) for which steps and time of the first test that reaches them are reported."""


@dataclass(frozen=True)
class Estimate:
    """A statistic over the seeds with an interval of some `kind`."""

    value: float
    low: float
    high: float
    kind: IntervalKind


@dataclass(frozen=True)
class Improvement:
    """Probability that a run is better than one of the first contender (ties one half), and its bootstrap interval.

    low and high are None if one of the two has fewer than 5 seeds. `approximate`: one has fewer than 10.
    """

    probability: float
    low: float | None
    high: float | None
    approximate: bool


@dataclass(frozen=True)
class Reaching:
    """When a test first reached a success ratio: medians over the seeds, None if half of them or more never did."""

    ratio: float
    reached: int
    """Number of seeds that reached it."""
    seeds: int
    steps: float | None
    seconds: float | None


@dataclass(frozen=True)
class Scores:
    """One contender's numbers. `iqm`, `reaching`, `improvement` and `density` use the comparison's `success`."""

    any: Estimate
    end: Estimate
    iqm: Estimate
    reaching: tuple[Reaching, ...]
    best_end: Estimate | None
    """Success at the end of the policies `best` in the final test; None if a run has none."""
    improvement: Improvement | None
    """None for the first contender."""
    density: statistics.Density | None
    """Over the seeds; None for a single one."""
    steps: float
    """Environment steps of a run, mean over seeds; so are the following."""
    seconds: float
    updates_per_second: float | None


@dataclass(frozen=True)
class Comparison:
    """Contenders with their scores in the same order, the settings that differ, and warnings."""

    success: Success
    contenders: tuple[Contender, ...]
    scores: tuple[Scores, ...]
    parameters: Mapping[str, tuple[Any, ...]]
    """Key path -> the value in each contender's spec, MISSING if the key is missing; only settings that differ."""
    warnings: tuple[str, ...]

    def rows(self) -> list[dict[str, Any]]:
        """One JSON object per contender."""
        return list(map(self._row, range(len(self.contenders)), self.contenders, self.scores))

    def _row(self, place: int, contender: Contender, scores: Scores) -> dict[str, Any]:
        runs, density = contender.runs, scores.density
        reached = {
            f"{unit}_to_{one.ratio * 100:g}": {"median": getattr(one, unit), "reached": one.reached, "of": one.seeds}
            for one in scores.reaching
            for unit in ("steps", "seconds")
        }
        return {
            "label": contender.label,
            "experiment": contender.experiment,
            "name": runs[0].summary.name,
            "n": len(runs),
            "seeds": [run.summary.seed for run in runs],
            "runs": [run.summary.run for run in runs],
            "success": self.success,
            "success_any": asdict(scores.any) | {"seeds": [run.reported("any") for run in runs]},
            "success_end": asdict(scores.end) | {"seeds": [run.reported("end") for run in runs]},
            "best_end": scores.best_end and asdict(scores.best_end),
            "final": all(run.summary.final for run in runs),
            "iqm": asdict(scores.iqm),
            "density": density and {key: getattr(density, key) for key in ("modes", "mean", "low", "high")},
            **reached,
            "improvement": scores.improvement and asdict(scores.improvement),
            "steps": scores.steps,
            "seconds": scores.seconds,
            "updates_per_second": scores.updates_per_second,
            "parameters": {
                path: values[place] for path, values in self.parameters.items() if values[place] is not MISSING
            },
            "warnings": list(self.warnings),
        }


def compare(contenders: Sequence[Contender], success: Success = "end") -> Comparison:
    """The numbers of all contenders. Improvements are relative to the first."""
    tree = SeedTree(0).child("compare")
    scores = tuple(
        _scores(contender, contenders[0] if place else None, success, tree.child(place))
        for place, contender in enumerate(contenders)
    )
    parameters = differences([without_seeds(contender.spec) for contender in contenders])
    return Comparison(success, tuple(contenders), scores, parameters, cautions(contenders))


def _scores(contender: Contender, first: Contender | None, success: Success, tree: SeedTree) -> Scores:
    runs = contender.runs
    values = [run.reported(success) for run in runs]
    best = [run.summary.best_end for run in runs if run.summary.best_end is not None]
    rates = [run.updates_per_second for run in runs if run.updates_per_second is not None]
    return Scores(
        any=_estimate([run.reported("any") for run in runs], runs, aggregates.mean, tree.child("any")),
        end=_estimate([run.reported("end") for run in runs], runs, aggregates.mean, tree.child("end")),
        iqm=_estimate(values, runs, aggregates.iqm, tree.child("iqm")),
        best_end=_estimate(best, runs, aggregates.mean, tree.child("best")) if len(best) == len(runs) else None,
        reaching=tuple(_reaching(runs, success, ratio) for ratio in RATIOS),
        improvement=None if first is None else _improvement(runs, first.runs, success, tree.child("improvement")),
        density=statistics.kde(values) if len(values) > 1 else None,
        steps=float(np.mean([run.summary.steps for run in runs])),
        seconds=float(np.mean([run.summary.seconds for run in runs])),
        updates_per_second=float(np.mean(rates)) if rates else None,
    )


def _estimate(
    values: Sequence[float], runs: Sequence[ComparedRun], statistic: aggregates.Statistic, tree: SeedTree
) -> Estimate:
    """A statistic of one value per run, with the kind of interval that the number of seeds allows."""
    middle = float(statistic(np.array(values)))
    if len(runs) == 1:
        episodes = runs[0].episodes
        return Estimate(middle, *wilson(round(values[0] * episodes), episodes), "wilson")
    found = aggregates.interval(values, statistic, tree.generator())
    if found is None:
        return Estimate(middle, min(values), max(values), "range")
    usual = aggregates.reliability(len(values)) == "usual"
    return Estimate(middle, *found, "bootstrap" if usual else "approximate")


def _reaching(runs: Sequence[ComparedRun], success: Success, ratio: float) -> Reaching:
    at = {
        axis: [aggregates.first_reaching(run.ratios(success), list(places(run, axis)), ratio) for run in runs]
        for axis in ("steps", "seconds")
    }
    return Reaching(
        ratio=ratio,
        reached=sum(place is not None for place in at["steps"]),
        seeds=len(runs),
        steps=aggregates.median_reaching(at["steps"]),
        seconds=aggregates.median_reaching(at["seconds"]),
    )


def _improvement(
    ours: Sequence[ComparedRun], theirs: Sequence[ComparedRun], success: Success, tree: SeedTree
) -> Improvement:
    one, other = [run.reported(success) for run in ours], [run.reported(success) for run in theirs]
    low, high = aggregates.improvement_interval(one, other, tree.generator()) or (None, None)
    approximate = low is not None and "approximate" in {aggregates.reliability(len(side)) for side in (one, other)}
    return Improvement(aggregates.improvement(one, other), low, high, approximate)
