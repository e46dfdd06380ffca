"""The numbers of a comparison. The seed is the unit: a run gives one number, an experiment one per seed.

A run's success and return are those of its final test, whose episodes are held out; without one, of its last test.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..core.seeding import SeedTree
from ..errors import UsageError
from ..records.evaluation import Measured
from ..records.intervals import wilson
from ..records.run_records import Metric, RunRecord, Success, without_seeds
from ..store import Store
from ..store.density import Density
from ..store.experiments import success_densities
from . import aggregates
from .contenders import Contender, cautions
from .curves import densities, places
from .differences import MISSING, differences
from .reaching import first_reaching, median_reaching

IntervalKind = Literal["none", "wilson", "range", "approximate", "bootstrap"]
"""Kind of an interval. Wilson's: one run. Smallest to largest: 2 - 4 seeds. Bootstrap: 5 - 9 seeds, where it covers too
little, or 10 and more. None: one run's return, an improvement over fewer than 5 seeds, or more than 2.5 % unknown
resamples. Wilson's and both bootstraps are at 95 %."""
RATIOS = (0.5, 0.9)
"""Success ratios (`end` by default) for which steps and time of the first test that reaches them are reported."""


@dataclass(frozen=True)
class Estimate:
    """A statistic over the seeds with an interval of some `kind`. A ratio and its ends may be inf."""

    value: float
    low: float
    high: float
    kind: IntervalKind


@dataclass(frozen=True)
class Reaching:
    """When a test first reached a success ratio: medians over the seeds; None if half of the seeds or more never did.

    For an even number of seeds it is the mean of the two middle values.
    """

    ratio: float
    reached: int
    """Number of seeds that reached it."""
    seeds: int
    steps: float | None
    seconds: float | None


@dataclass(frozen=True)
class Scores:
    """One contender's numbers. `iqm`, `reaching`, `improvement` and `density` use the comparison's `metric`."""

    any: Estimate | None
    """Success; None if it is unknown."""
    end: Estimate | None
    returns: Estimate
    iqm: Estimate
    reaching: tuple[Reaching, ...]
    """Empty for returns."""
    best_end: Estimate | None
    """Success at the end of the policies `best` in the final test; None if a run has no such test."""
    best_return: Estimate | None
    improvement: Estimate | None
    """Probability that a run is better than one of the first contender (ties one half); None for the first itself."""
    measures: Mapping[str, Estimate | None]
    """By name: means over the episodes of the reported test; None if in a run no episode defines the measure."""
    density: Density | None
    """Density of the reported success over the seeds; None for a single one and for returns."""
    over_steps: tuple[NDArray[np.float64], tuple[Density, ...]] | None
    """Environment steps (t,) and the density at each; None for a single seed and for returns."""
    steps: float
    """Environment steps of a run. This and the following are means over seeds."""
    seconds: float
    updates_per_second: float | None


@dataclass(frozen=True)
class Comparison:
    """Contenders with their scores in the same order, the settings that differ, and warnings."""

    metric: Metric
    contenders: tuple[Contender, ...]
    scores: tuple[Scores, ...]
    parameters: Mapping[str, tuple[Any, ...]]
    """Key path -> the value in each contender's spec, MISSING if the key is missing; only settings that differ."""
    warnings: tuple[str, ...]
    at: int | None = None
    """Environment steps at which the runs are compared; None: at their ends."""

    @property
    def labels(self) -> list[str]:
        """The names of the contenders."""
        return [contender.label for contender in self.contenders]

    @property
    def what(self) -> Literal["success", "return"]:
        """Word for the compared quantity."""
        return "return" if self.metric == "return" else "success"

    @property
    def measures(self) -> dict[str, Measured]:
        """Unit and direction of each measure that a contender has, by name."""
        return {
            name: measure
            for contender in self.contenders
            for run in contender.runs
            for name, measure in run.summary.measures.items()
        }

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
            "metric": self.metric,
            "at": self.at,
            "success_any": scores.any and asdict(scores.any) | {"seeds": [run.reported("any") for run in runs]},
            "success_end": scores.end and asdict(scores.end) | {"seeds": [run.reported("end") for run in runs]},
            "mean_return": asdict(scores.returns) | {"seeds": [run.reported("return") for run in runs]},
            "best_end": scores.best_end and asdict(scores.best_end),
            "best_return": scores.best_return and asdict(scores.best_return),
            "measures": {
                name: {"unit": one["unit"], "better": one["better"]}
                | (asdict(found) if (found := scores.measures.get(name)) else {"value": None})
                | {"seeds": [run.measured(name) for run in runs]}
                for name, one in runs[0].summary.measures.items()
            },
            "final": all(run.summary.final for run in runs),
            "iqm": asdict(scores.iqm),
            "density": density and {key: getattr(density, key) for key in ("modes", "mean", "low", "high")},
            **reached,
            "improvement": scores.improvement and _improvement_row(scores.improvement),
            "steps": scores.steps,
            "seconds": scores.seconds,
            "updates_per_second": scores.updates_per_second,
            "parameters": {
                path: values[place] for path, values in self.parameters.items() if values[place] is not MISSING
            },
            "warnings": list(self.warnings),
        }


def compare(
    contenders: Sequence[Contender],
    metric: Metric | None = None,
    store: Store | None = None,
    *,
    at: int | None = None,
) -> Comparison:
    """The numbers of all contenders. Improvements are relative to the first.

    `metric` is that of curves, thresholds and improvements; by default `end`, or `return` if the success of one is
    unknown. The store keeps the densities; without one they are computed. With `at`, the runs are compared as they were
    at their tests nearest to these environment steps.

    Raises UsageError if success is compared but unknown for a contender, or a run has no test near `at`.
    """
    if at is not None:
        contenders = [replace(one, runs=tuple(run.at(at) for run in one.runs)) for one in contenders]
        store = None
    unknown = [contender.label for contender in contenders if not contender.has_success]
    if unknown and metric in ("any", "end"):
        raise UsageError(
            f"the environment of {', '.join(unknown)} does not define success",
            where="--metric",
            hint="--metric return compares returns",
        )
    metric = metric or ("return" if unknown else "end")
    tree = SeedTree(0).child("compare")
    scores = tuple(
        _scores(contender, contenders[0] if place else None, metric, tree.child(place), store)
        for place, contender in enumerate(contenders)
    )
    parameters = differences([without_seeds(contender.spec) for contender in contenders])
    return Comparison(metric, tuple(contenders), scores, parameters, cautions(contenders), at)


def _scores(
    contender: Contender, first: Contender | None, metric: Metric, tree: SeedTree, store: Store | None
) -> Scores:
    runs = contender.runs
    reported = {kind: [run.reported(kind) for run in runs] for kind in get_args(Metric)}
    rates = [run.updates_per_second for run in runs if run.updates_per_second is not None]
    steps = float(np.mean([run.summary.steps for run in runs]))
    density = over_steps = None
    if metric != "return" and len(runs) > 1:
        [density] = success_densities(store, contender.experiment, metric, {steps: reported[metric]}, reported=True)
        over_steps = densities(contender, metric, store)

    def of_metric(values: Sequence[float], kind: Metric, statistic: aggregates.Statistic, name: str) -> Estimate:
        found = estimate([values], statistic, tree.child(name), None if kind == "return" else runs[0].episodes)
        return found or Estimate(math.nan, math.nan, math.nan, "none")

    def mean(of: Sequence[float | None], kind: Metric, name: str) -> Estimate | None:
        known = [value for value in of if value is not None]
        return of_metric(known, kind, aggregates.mean, name) if len(known) == len(of) else None

    return Scores(
        any=mean(reported["any"], "any", "any") if contender.has_success else None,
        end=mean(reported["end"], "end", "end") if contender.has_success else None,
        returns=of_metric(reported["return"], "return", aggregates.mean, "return"),
        iqm=of_metric(reported[metric], metric, aggregates.iqm, "iqm"),
        best_end=mean([run.summary.best_end for run in runs], "end", "best"),
        best_return=mean([run.summary.best_return for run in runs], "return", "best_return"),
        measures={
            name: mean([run.measured(name) for run in runs], "return", f"measure {name}")
            for name in runs[0].summary.measures
        },
        reaching=() if metric == "return" else tuple(reaching(runs, metric, ratio) for ratio in RATIOS),
        improvement=None if first is None else _improvement(runs, first.runs, metric, tree.child("improvement")),
        density=density,
        over_steps=over_steps,
        steps=steps,
        seconds=float(np.mean([run.summary.seconds for run in runs])),
        updates_per_second=float(np.mean(rates)) if rates else None,
    )


@lru_cache(maxsize=4096)
def estimate_alone(values: tuple[float, ...], episodes: int | None) -> Estimate | None:
    """The number and interval that `compare` shows for a single experiment: success of `episodes`, or returns."""
    name = "return" if episodes is None else "end"
    tree = SeedTree(0).child("compare").child(0).child(name)
    return estimate([values], aggregates.mean, tree, episodes) if values else None


def estimate(
    rows: Sequence[Sequence[float]],
    statistic: Callable[..., NDArray[np.float64]],
    tree: SeedTree,
    episodes: int | None = None,
) -> Estimate | None:
    """A statistic of one or several values per run, with the kind of interval that the number of seeds allows.

    `rows` are values of the runs (n,) each, paired by the run; the statistic maps one array (..., n) per row to (...).
    `tree` gives the bootstrap's random numbers. `episodes` is their number if the value of a single run is a success
    ratio. None if the statistic is nan.
    """
    table = np.array(rows, float)
    middle, seeds = float(statistic(*table)), table.shape[1]
    if math.isnan(middle):
        return None
    if seeds == 1 and episodes:
        return Estimate(middle, *wilson(round(middle * episodes), episodes), "wilson")
    if seeds == 1:
        return Estimate(middle, middle, middle, "none")
    found = aggregates.paired_interval(list(table), statistic, tree.generator())
    if aggregates.reliability(seeds) == "none":
        each = statistic(*table[:, :, None])  # of each seed alone
        each = each[~np.isnan(each)]
        return Estimate(middle, float(each.min(initial=middle)), float(each.max(initial=middle)), "range")
    return _bootstrapped(middle, found, seeds)


def _bootstrapped(value: float, interval: tuple[float, float] | None, seeds: int) -> Estimate:
    """A value with its bootstrap interval over this number of seeds, or without one."""
    if interval is None:
        return Estimate(value, value, value, "none")
    return Estimate(value, *interval, "bootstrap" if aggregates.reliability(seeds) == "usual" else "approximate")


def reaching(runs: Sequence[RunRecord], success: Success, ratio: float) -> Reaching:
    """When the tests of some runs first reached a success ratio."""
    at = {
        axis: [first_reaching(run.values(success), list(places(run, axis)), ratio) for run in runs]
        for axis in ("steps", "seconds")
    }
    return Reaching(
        ratio=ratio,
        reached=sum(place is not None for place in at["steps"]),
        seeds=len(runs),
        steps=median_reaching(at["steps"]),
        seconds=median_reaching(at["seconds"]),
    )


def _improvement(ours: Sequence[RunRecord], theirs: Sequence[RunRecord], metric: Metric, tree: SeedTree) -> Estimate:
    one, other = [run.reported(metric) for run in ours], [run.reported(metric) for run in theirs]
    found = aggregates.improvement_interval(one, other, tree.generator())
    return _bootstrapped(aggregates.improvement(one, other), found, min(len(one), len(other)))


def _improvement_row(found: Estimate) -> dict[str, Any]:
    low, high = (None, None) if found.kind == "none" else (found.low, found.high)
    return {"probability": found.value, "low": low, "high": high, "approximate": found.kind == "approximate"}
