"""The best trials on fresh seeds: choose by some, report on others.

Tuned hyper-parameters are too good on the seeds that they were tuned on (Eimer et al. 2023, "Hyperparameters in
Reinforcement Learning and How To Tune Them"); the gap says by how much.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count, islice

from ..experiment.events import RunWarned
from ..experiment.signals import StopRequest
from ..records.sweep_records import SweepFinal, Trial, merit
from ..spec import Spec, spec_of_trial
from ..spec.sweep import Final as Settings
from .crew import Crew, Job
from .objectives import directions, measure
from .records import FinalBegan, SweepListener
from .study import Study


def choose(
    base: Spec, settings: Settings, study: Study, crew: Crew, tell: SweepListener, stop: StopRequest
) -> SweepFinal | None:
    """Run the best trials on fresh seeds, choose among them, and run the chosen one on seeds used for nothing else.

    Runs that are there already are taken. None where every trial failed on the fresh seeds, or somebody asked to stop.
    """
    sweep = base.sweep
    assert sweep is not None  # its trials are there
    unused = (seed for seed in count() if seed not in sweep.seeds)
    seeds = tuple(islice(unused, settings.seeds))
    report_seeds = tuple(islice(unused, settings.report_seeds))
    best = study.ranked()[: settings.top]
    tell(FinalBegan(tuple(trial.number for trial in best), seeds, "choose"))
    fresh = _values(base, best, seeds, crew, tell, stop)
    if stop.requested or not fresh:
        return None
    ways = directions(sweep.objectives)
    chosen = min((trial for trial in best if trial.number in fresh), key=lambda one: merit(fresh[one.number], ways))
    tell(FinalBegan((chosen.number,), report_seeds, "report"))
    reported = _values(base, [chosen], report_seeds, crew, tell, stop)
    if stop.requested:
        return None
    assert chosen.values is not None  # it is complete
    return SweepFinal(chosen.number, seeds, report_seeds, chosen.values, fresh, reported.get(chosen.number))


def _values(
    base: Spec, trials: Sequence[Trial], seeds: tuple[int, ...], crew: Crew, tell: SweepListener, stop: StopRequest
) -> dict[int, tuple[float, ...]]:
    """The trials' objectives on these seeds; trials that failed on one are missing."""
    jobs = {trial.number: Job(spec_of_trial(base, trial.drawn, trial.name, seeds, trial.name)) for trial in trials}
    crew.run(_Jobs(list(jobs.values()), tell), stop)
    assert base.sweep is not None  # see `choose`
    found = {
        number: tuple(measure(name, job.results(), job.spec.training.steps) for name in base.sweep.objectives)
        for number, job in jobs.items()
        if job.finished
    }
    return {number: values for number, values in found.items() if all(map(math.isfinite, values))}


@dataclass
class _Jobs:
    """A list of jobs, all of which are to come to their end."""

    waiting: list[Job]
    tell: SweepListener

    def next(self) -> Job | None:
        return self.waiting.pop(0) if self.waiting else None

    def tested(self, job: Job) -> str | None:  # noqa: ARG002  (none is given up)
        return None

    def ended(self, job: Job) -> None:
        pass  # whoever made the list looks at it

    def warned(self, event: RunWarned) -> None:
        self.tell(event)
