"""Search: a spec's sweep from its first trial to the best settings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from ..assembly import check_parts
from ..errors import SpecError, UsageError
from ..events import RunWarned
from ..experiment import SeedRunner
from ..run_folder import RunFolder
from ..signals import StopRequest, stop_on_signals
from ..spec import Spec, Sweep, spec_of_trial
from ..spec.sweep import DEFAULT_TRIALS
from ..store import Store
from ..transfer import pinned
from . import choosing
from .crew import Crew, Job
from .folder import FOLDER, SweepFolder
from .objectives import measure, nominal_steps, so_far
from .records import Final, Outcome, SweepEvent, SweepListener, Trial, TrialBegan, TrialEnded
from .study import OpenTrial, Study

LONGEST_NAME = 58
"""Of a sweep, so that its trials' runs can be called <name>-t0000."""
PRUNED = "pruned"


class Search:
    """Carries a spec's sweep out: each trial is the spec with other values, run on the sweep's seeds.

    Args:
        spec: a Spec with a sweep, or a dictionary of the same shape as a spec file.
        text: the spec as its author wrote it, kept in every run's folder.
        trials: how many the sweep is to have, instead of what the spec says.

    Raises:
        SpecError: the dictionary is no valid spec; carries every problem found.
        UsageError: there is no sweep in it, or its name is too long.
    """

    def __init__(self, spec: Spec | Mapping[str, Any], *, text: str | None = None, trials: int | None = None) -> None:
        found = spec if isinstance(spec, Spec) else Spec.from_dict(dict(spec))
        sweep = _sweep_of(found)
        self.sweep = sweep if trials is None else sweep.model_copy(update={"trials": trials})
        self.spec = found.model_copy(update={"sweep": self.sweep})
        self._text = text

    @property
    def asked(self) -> int:
        """How many trials the sweep is to have."""
        most = self.sweep.trials or DEFAULT_TRIALS
        if self.sweep.sampler != "grid":
            return most
        size = sum(1 for _ in self.sweep.combinations())
        return min(self.sweep.trials or size, size)

    def folder(self, runs: str | Path) -> Path:
        """The sweep's own folder in a runs folder."""
        return Path(runs) / FOLDER / self.spec.name

    def run(
        self,
        runs: str | Path = "runs",
        *,
        database: str | None = None,
        jobs: int = 1,
        time_limit: float | None = None,
        listener: SweepListener | None = None,
    ) -> Outcome:
        """Carry out the trials that are missing, choose the best, and write down what was found.

        The same call after an interruption goes on: trials that had begun are finished, their runs from their newest
        checkpoints, and none is run twice. A trial fails when one of its runs does, or when its parts do not go
        together; it counts as one of the trials.

        Args:
            runs: folder of the run folders; the sweep's own is `sweeps/<name>` in it.
            database: SQLAlchemy URL of the results database.
            jobs: trials at the same time; each seed of each is a process.
            time_limit: seconds after which to stop.
            listener: is called with every SweepEvent.

        Raises:
            UsageError: the spec's parts do not go together, or a sweep of this name searches something else.
            RunError: another process carries this sweep out.
            MachineError: the runs folder cannot be written, or processes cannot be started.
            StoreError: the database cannot be used.
        """
        if jobs < 1:
            raise UsageError(f"jobs is {jobs}", hint="run at least one trial at a time")
        root = Path(runs)
        url = database or Store.default_url(root)
        check_parts(self.spec)
        RunFolder.check_writable(root)
        Store(url).close()
        runner = SeedRunner({}, root, url, self._text, "resume")
        tell = listener or _ignore
        base = pinned(self.spec, root)
        size = jobs * len(self.sweep.seeds)
        folder = SweepFolder(self.folder(root), self.spec)
        with folder, stop_on_signals(time_limit=time_limit) as stop, Crew(size, folder.workers, runner) as crew:
            study = Study(folder.journal, self.sweep, self.spec.name, self.spec.training.steps)
            feed = _Trials(base, self.sweep, study, jobs, self.asked, tell, stop, folder)
            crew.run(feed, stop)
            final = None
            if self.sweep.final is not None and not stop.asked and study.ranked():
                final = choosing.choose(base, self.sweep.final, study, crew, tell, stop)
            return self._conclude(study, folder, final, stop)

    def _conclude(self, study: Study, folder: SweepFolder, final: Final | None, stop: StopRequest) -> Outcome:
        from ..report.search import write_search_figures  # noqa: PLC0415  (matplotlib takes half a second)

        folder.write_trials(study.trials())
        ranked = study.ranked()
        best = study.trial(final.chosen) if final is not None else ranked[0] if ranked else None
        if best is not None:
            seeds = self.spec.seeds if final is None else final.report_seeds
            spec = spec_of_trial(self.spec, best.drawn, f"{self.spec.name}-best", seeds, best.name)
            folder.write_best(spec, _comment(self.sweep, best, final))
            write_search_figures(
                study.trials(), self.sweep.objectives[0], self.sweep.space, study.importances(), folder.figures
            )
        if final is not None:
            folder.write_final({"objectives": list(self.sweep.objectives), **final.row()})
        return Outcome(
            sweep=self.sweep,
            trials=study.trials(),
            asked=self.asked,
            best=best,
            front=study.front(),
            final=final,
            folder=folder.path,
            stop_code=stop.exit_code,
        )


def samples(spec: Spec, count: int) -> Iterator[tuple[dict[str, Any], Spec | SpecError]]:
    """What trials may draw, each with its spec or why that is none: at random, or a grid's first combinations."""
    sweep = _sweep_of(spec)
    drawn = list(islice(sweep.combinations(), count)) if sweep.sampler == "grid" else Study.draws(sweep, count)
    for place, values in enumerate(drawn):
        name = f"{spec.name}-t{place:03}"
        try:
            yield values, spec_of_trial(spec, values, name, sweep.seeds, name)
        except SpecError as error:
            yield values, error


@dataclass
class _Trials:
    """The sweep's trials as a crew's jobs."""

    base: Spec
    sweep: Sweep
    study: Study
    jobs: int
    asked: int
    tell: SweepListener
    stop: StopRequest
    folder: SweepFolder
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
        """Report the mean at each test that every seed has had; PRUNED once the pruner gives the trial up."""
        if self.sweep.pruner is None:
            return None
        results, settings = job.results(), job.spec
        while (count := self._reported[job] + 1) <= min(len(tests) for tests in results.values()):
            self._reported[job] = count
            last = next(iter(results.values()))[count - 1]
            step = nominal_steps(last.steps, settings.testing.interval, settings.training.steps)
            value = so_far(self.sweep.objectives[0], results, count)
            if step >= settings.training.steps or not math.isfinite(value):
                continue  # it is over anyway, and no number is a failure and no reason to prune
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
        elif not self.stop.asked:
            self._fail(trial, runs, "a run was stopped from outside")
        # else it stays open, and the next call of the sweep goes on with it

    def warned(self, event: RunWarned) -> None:
        self.tell(event)

    def _fail(self, trial: OpenTrial, runs: tuple[str, ...], error: str) -> None:
        trial.describe(runs, error)
        self.study.fail(trial)
        self._ended(trial)

    def _ended(self, trial: OpenTrial) -> None:
        trials = self.study.trials()
        self.folder.write_trials(trials)
        done = sum(one.state != "running" for one in trials)
        self.tell(TrialEnded(trials[trial.number], done, self.asked))


def _sweep_of(spec: Spec) -> Sweep:
    """The spec's sweep. Raises UsageError where there is none, or the name leaves no room for its trials'."""
    if spec.sweep is None:
        raise UsageError(
            f"the spec {spec.name!r} has no sweep",
            hint="add e.g. sweep: {space: {agent.learning_rate: {float: [1e-5, 1e-2], log: true}}}",
        )
    if len(spec.name) > LONGEST_NAME:
        raise UsageError(
            f"the name {spec.name!r} is longer than {LONGEST_NAME} characters, which leaves no room for its trials'",
            where="name",
            hint="give a shorter one (name=...)",
        )
    return spec.sweep


def _comment(sweep: Sweep, best: Trial, final: Final | None) -> Iterator[str]:
    """The lines above the best trial's spec."""
    drawn = ", ".join(f"{key} = {value}" for key, value in best.drawn.items())
    yield f"Trial {best.number} of a sweep: {drawn}."
    for place, name in enumerate(sweep.objectives):
        if best.values is not None:
            yield f"{name} {best.values[place]:.4g} on the seeds it was tuned on ({_listed(sweep.seeds)})"
        if final is not None:
            yield f"{name} {final.fresh[best.number][place]:.4g} on the seeds it was chosen by ({_listed(final.seeds)})"
        if final is not None and final.reported is not None:
            yield f"{name} {final.reported[place]:.4g} on seeds used for nothing else ({_listed(final.report_seeds)})"


def _listed(seeds: tuple[int, ...]) -> str:
    return ", ".join(map(str, seeds))


def _ignore(event: SweepEvent) -> None:
    pass
