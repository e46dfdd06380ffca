"""The final phase of a sweep: choose among the best trials on new seeds, and report on further seeds.

Hyper-parameters overfit the seeds that they were tuned on (Eimer et al. 2023, "Hyperparameters in Reinforcement
Learning and How To Tune Them").
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import count, islice

from ..launchers.driver import Driver, Feed
from ..launchers.runs import Home, RunJob
from ..records.sweep_records import SweepFinal, SweepRecord, Trial, merit
from ..specification import Spec, spec_of_trial
from ..store import Store
from .events import FinalBegan, SweepListener
from .objectives import measure_all

REPORT_SEED_OFFSET = 2_000_000
"""Distance of the reporting runs' `testing.seed` from the spec's: nothing was tuned or chosen on their tests."""


def for_search(trial: Spec) -> Spec:
    """A trial's spec without the final test, which says nothing to the search."""
    return trial.model_copy(update={"testing": trial.testing.model_copy(update={"final_episodes": 0})})


def for_report(trial: Spec) -> Spec:
    """A trial's spec whose tests play other episodes than those it was tuned and chosen on."""
    seed = trial.testing.seed + REPORT_SEED_OFFSET
    return trial.model_copy(update={"testing": trial.testing.model_copy(update={"seed": seed})})


def unused_seeds(base: Spec) -> Iterator[int]:
    """Seeds from 0 that are neither the sweep's nor the spec's."""
    assert base.sweep is not None  # callers see to it
    known = {*base.sweep.seeds, *base.seeds}
    return (seed for seed in count() if seed not in known)


def choose(
    base: Spec, home: Home, found: SweepRecord, driver: Driver, listener: SweepListener, store: Store
) -> SweepFinal | None:
    """Run the best trials on new seeds, choose the best of them, and run it on further seeds and test episodes.

    No seed is one of the sweep or of the spec, and no trial has a run on one of the further seeds but its report.
    Uses finished runs of an earlier call. Returns None if every trial failed on the new seeds, or after a stop request.
    """
    sweep = base.sweep
    assert sweep is not None and sweep.final is not None  # noqa: PT018 (callers see to it)

    def run(jobs: Sequence[RunJob]) -> None:
        driver.run(Feed(*jobs))

    unused = unused_seeds(base)
    seeds = tuple(islice(unused, sweep.final.seeds))
    best = found.ranked[: sweep.final.top]
    listener(FinalBegan(tuple(trial.number for trial in best), seeds, "choose"))
    fresh = _values(base, home, best, seeds, for_search, run)
    if driver.stop.requested or not fresh:
        return None
    chosen = min(
        (trial for trial in best if trial.number in fresh),
        key=lambda one: merit(fresh[one.number], found.directions),
    )
    report = for_report(spec_of_trial(base, chosen.drawn, chosen.name, base.seeds, chosen.name)).hash()
    names = {trial.name for trial in found.trials}
    used = {run.seed for run in store.runs() if run.name in names and run.experiment != report}
    report_seeds = tuple(islice((seed for seed in unused if seed not in used), sweep.final.report_seeds))
    listener(FinalBegan((chosen.number,), report_seeds, "report"))
    reported = _values(base, home, [chosen], report_seeds, for_report, run)
    if driver.stop.requested:
        return None
    assert chosen.values is not None  # it is complete
    return SweepFinal(chosen.number, seeds, report_seeds, chosen.values, fresh, reported.get(chosen.number))


def _values(
    base: Spec,
    home: Home,
    trials: Sequence[Trial],
    seeds: tuple[int, ...],
    change: Callable[[Spec], Spec],
    run: Callable[[Sequence[RunJob]], None],
) -> dict[int, tuple[float, ...]]:
    """The trials' objectives with their specs changed and on these seeds, without trials that failed on a seed."""
    specs = {trial.number: spec_of_trial(base, trial.drawn, trial.name, seeds, trial.name) for trial in trials}
    jobs = {number: RunJob(change(spec), home, together=True) for number, spec in specs.items()}
    run(list(jobs.values()))
    assert base.sweep is not None  # see `choose`
    values = {number: measure_all(base.sweep.objectives, job) for number, job in jobs.items() if job.finished}
    return {number: value for number, value in values.items() if all(map(math.isfinite, value))}
