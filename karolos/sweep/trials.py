"""The trials of a sweep as jobs of a pool: sampled, run, evaluated and recorded."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ..errors import SpecError, StoreError
from ..experiment.events import RunWarned
from ..experiment.signals import StopRequest
from ..records.sweep_records import read_sweep
from ..spec import Spec, Sweep, spec_of_trial
from ..store import Store
from .events import SweepListener, TrialBegan, TrialEnded
from .folder import SweepFolder
from .objectives import measure, nominal_steps, so_far
from .pool import Job
from .study import OpenTrial, Study

PRUNED = "pruned"


@dataclass(frozen=True)
class TrialWriter:
    """Writes a sweep's trials into its folder, and indexes the folder in the store."""

    folder: SweepFolder
    study: Study
    store: Store
    tell: SweepListener

    def write(self) -> None:
        """Write the current trials."""
        self.folder.write_trials(self.study.trials())
        self.index()

    def index(self) -> None:
        """Update the store. A store that fails causes a warning and does not end the sweep."""
        found, _ = read_sweep(self.folder.path)
        try:
            self.store.sweeps.add([found])
        except StoreError as error:
            self.tell(RunWarned(found.sweep, f"{error} (the sweep continues; its folder is complete)"))


@dataclass
class Trials:
    """The feed of a sweep's trials."""

    base: Spec
    sweep: Sweep
    study: Study
    jobs: int
    asked: int
    tell: SweepListener
    stop: StopRequest
    writer: TrialWriter
    _open: dict[Job, OpenTrial] = field(default_factory=dict)
    _reported: dict[Job, int] = field(default_factory=dict)
    _left: list[OpenTrial] | None = None

    def next(self) -> Job | None:
        if self._left is None:
            self._left = self.study.unfinished()
        while len(self._open) < self.jobs:
            if self._left:
                trial = self._left.pop(0)
            elif len(self.study.trials()) < self.asked:
                trial = self.study.ask()
            else:
                return None
            job = self._begin(trial)
            if job is not None:
                return job
        return None

    def _begin(self, trial: OpenTrial) -> Job | None:
        record = self.study.trial(trial.number)
        self.writer.write()
        self.tell(TrialBegan(record))
        try:
            spec = spec_of_trial(self.base, trial.drawn, record.name, self.sweep.seeds, record.name)
        except SpecError as error:
            self._fail(trial, (), str(error).replace("\n", "; "))
            return None
        job = Job(spec)
        self._open[job] = trial
        self._reported[job] = 0
        return job

    def tested(self, job: Job) -> str | None:
        """Report the mean at each test that every seed has completed; PRUNED when the pruner stops the trial."""
        if self.sweep.pruner is None:
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

    def ended(self, job: Job) -> None:
        trial = self._open.pop(job)
        runs = tuple(job.summaries[seed].run for seed in job.spec.seeds if seed in job.summaries)
        if job.finished:
            values = [measure(name, job.results(), job.spec.training.steps) for name in self.sweep.objectives]
            if all(math.isfinite(value) for value in values):
                trial.describe(runs, None)
                self.study.complete(trial, values)
                self._ended(trial)
            else:
                self._fail(trial, runs, f"{' and '.join(self.sweep.objectives)} came to {values}")
        elif job.error is not None:
            self._fail(trial, runs, job.error)
        elif job.halted == PRUNED:
            trial.describe(runs, None)
            self.study.prune(trial)
            self._ended(trial)
        elif not self.stop.requested:
            self._fail(trial, runs, "a run was stopped from outside")
        # otherwise the trial stays open and the next call of the sweep resumes it

    def warned(self, event: RunWarned) -> None:
        self.tell(event)

    def _fail(self, trial: OpenTrial, runs: tuple[str, ...], error: str) -> None:
        trial.describe(runs, error)
        self.study.fail(trial)
        self._ended(trial)

    def _ended(self, trial: OpenTrial) -> None:
        trials = self.study.trials()
        self.writer.write()
        done = sum(one.state != "running" for one in trials)
        self.tell(TrialEnded(trials[trial.number], done, self.asked))
