"""The trials of a sweep as jobs of a driver: sampled, run, evaluated and recorded."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from ..errors import KarolosError
from ..experiment.events import RunEvent, RunTested
from ..experiment.signals import StopRequest
from ..launchers.driver import Feed
from ..launchers.runs import Home, RunJob
from ..specification import Spec, Sweep, spec_of_trial
from ..training.assembly import check_parts
from .choosing import for_search
from .events import TrialBegan, TrialEnded
from .folder import SweepFolder
from .objectives import measure_all, nominal_steps, so_far
from .study import OpenTrial

PRUNED = "pruned"


@dataclass
class Trials(Feed[RunJob]):
    """The feed of a sweep's trials.

    Args:
        jobs: largest number of concurrent trials.
    """

    base: Spec
    home: Home
    sweep: Sweep
    jobs: int
    stop: StopRequest
    folder: SweepFolder
    _open: dict[RunJob, OpenTrial] = field(default_factory=dict)
    _reported: dict[RunJob, int] = field(default_factory=dict)
    """Number of tests that the pruner has seen."""

    def __post_init__(self) -> None:
        self._unfinished = self.folder.study.unfinished()

    def next(self) -> RunJob | None:
        while len(self._open) < self.jobs:
            if self._unfinished:
                trial = self._unfinished.pop(0)
            elif len(self.folder.study.trials()) < self.folder.asked:
                trial = self.folder.study.ask()
            else:
                return None
            name = self._tell(TrialBegan, trial)
            try:
                spec = for_search(spec_of_trial(self.base, trial.drawn, name, self.sweep.seeds, name))
                check_parts(spec)
            except KarolosError as error:
                self._end(trial, error=str(error).replace("\n", "; "))
                continue
            job = RunJob(spec, self.home, together=True)
            self._open[job] = trial
            self._reported[job] = 0
            return job
        return None

    def heard(self, job: RunJob, event: RunEvent) -> str | None:
        """Report the mean at each test that every seed has completed; PRUNED when the pruner stops the trial."""
        if self.sweep.pruner is None or not isinstance(event, RunTested) or job.halted:
            return None
        results, settings = job.results(), job.spec
        while (count := self._reported[job] + 1) <= min(len(tests) for tests in results.values()):
            self._reported[job] = count
            last = next(iter(results.values()))[count - 1]
            step = nominal_steps(last.steps, settings.testing.interval, settings.training.steps)
            value = so_far(self.sweep.objectives[0], results, count)
            if step >= settings.training.steps or not math.isfinite(value):
                continue  # the trial is over, or its value is not a number, which is no reason to prune
            if self._open[job].is_hopeless(value, step):
                return PRUNED
        return None

    def ended(self, job: RunJob) -> None:
        trial = self._open.pop(job)
        runs = [job.summaries[seed].run for seed in job.spec.seeds if seed in job.summaries]
        if job.finished:
            values = measure_all(self.sweep.objectives, job)
            finite = all(math.isfinite(value) for value in values)
            error = None if finite else f"{' and '.join(self.sweep.objectives)} came to {list(values)}"
            self._end(trial, runs, values if finite else None, error)
        elif job.error is not None or job.halted == PRUNED:
            self._end(trial, runs, error=job.error)
        elif not self.stop.requested:
            self._end(trial, runs, error="a run was stopped from outside")
        # otherwise the trial stays open and the next call of the sweep resumes it

    def _end(
        self,
        trial: OpenTrial,
        runs: Sequence[str] = (),
        values: Sequence[float] | None = None,
        error: str | None = None,
    ) -> None:
        trial.end(runs, values, error)
        self._tell(TrialEnded, trial)

    def _tell(self, event: type[TrialBegan] | type[TrialEnded], trial: OpenTrial) -> str:
        """Write the trials and tell the listener of this one; returns its name."""
        sweep = self.folder.write()
        found = sweep.trials[trial.number]
        self.folder.listener(event(found, sweep.ended, sweep.asked, next(iter(sweep.ranked), None)))
        return found.name
