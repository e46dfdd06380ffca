"""Search: a sweep over a spec's settings. Each trial is the spec with other values, run on the sweep's seeds.

runs/sweeps/<name>/
    sweep.yaml      the resolved spec with its sweep
    sweep.json      id and searched settings; `karolos.records.sweep_records` reads it, trials.jsonl and final.json
    journal.log     every trial, as Optuna's journal, to resume the sweep
    trials.jsonl    the same, one line per trial, for readers without Optuna
    best.yaml       the best trial as a spec
    final.json      the best trials on new seeds
    figures/        of the search
    lock            held by the process of the sweep

In the final phase the best trials run on new seeds, and the best of these on other new seeds: hyper-parameters overfit
the seeds of their tuning (Eimer et al. 2023, "Hyperparameters in Reinforcement Learning and How To Tune Them").
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from itertools import count, islice
from typing import Any

from typing_extensions import override

from ..errors import KarolosError, UsageError
from ..experiment.check import check_parts
from ..experiment.events import RunEvent, RunTested, RunWarned
from ..experiment.signals import StopRequestedError
from ..experiment.start_from import pinned
from ..launchers.runs import RunJob
from ..records.run_records import timestamp
from ..records.sweep_records import (
    BEST,
    DESCRIPTION,
    FINAL,
    FOLDER,
    TRIALS,
    FinalBegan,
    SweepFinal,
    SweepRecord,
    Trial,
    TrialChanged,
    best_name,
    merit,
    read_sweep,
    read_sweep_description,
)
from ..specification import Spec, load_spec, spec_from_dict, spec_of_trial, to_yaml
from ..specification.sweep import DEFAULT_TRIALS
from ..store import Store
from ..system.files import append_lines, write_json, write_whole, writing
from .objectives import directions, measure_all, nominal_steps, so_far
from .plan import Plan
from .study import OpenTrial, Study

LONGEST_NAME = 58
"""Longest name of a sweep, because its trials' runs are named <name>-t0000."""
PRUNED = "pruned"
REPORT_SEED_OFFSET = 2_000_000
"""Distance of the reporting runs' `testing.seed` from the spec's, so that their tests are held out."""
_FREE_SETTINGS = ("trials", "final")
"""Settings of a sweep that may change between two calls, because they do not change existing trials."""


class Search(Plan):
    """The sweep of a spec. A trial fails if a run of it fails or its parts do not fit together. Failed trials count.

    The spec may be a dictionary of the same shape as a spec file. `trials` replaces the spec's number of trials.

    Raises:
        SpecError: the dictionary is not a valid spec; lists every problem.
        UsageError: the spec has no sweep, or its name is too long.
    """

    what, place = "sweep", FOLDER
    front: tuple[Trial, ...] = ()
    """The Pareto front of the objectives, at the end."""

    def __init__(self, spec: Spec | Mapping[str, Any], *, trials: int | None = None) -> None:
        base = spec if isinstance(spec, Spec) else spec_from_dict(dict(spec))
        if base.sweep is None:
            raise UsageError(
                f"the spec {base.name!r} has no sweep",
                hint="add e.g. sweep: {space: {agent.learning_rate: {float: [1e-5, 1e-2], log: true}}}",
            )
        if len(base.name) > LONGEST_NAME:
            raise UsageError(
                f"the name {base.name!r} is longer than {LONGEST_NAME} characters; trials append to it",
                setting="name",
                hint="give a shorter one (name=...)",
            )
        self.sweep = base.sweep if trials is None else base.sweep.model_copy(update={"trials": trials})
        self.spec = base.model_copy(update={"sweep": self.sweep})
        self.name = self.folder_name = base.name

    @property
    def record(self) -> SweepRecord | None:
        """The sweep with its trials; None before it has begun."""
        return getattr(self, "_record", None)

    @property
    def asked(self) -> int:
        """Number of trials that the sweep should have."""
        most = self.sweep.trials or DEFAULT_TRIALS
        if self.sweep.sampler != "grid":
            return most
        size = sum(1 for _ in self.sweep.combinations())
        return min(self.sweep.trials or size, size)

    @property
    @override
    def at_once(self) -> int:
        """Number of processes: one per seed of each trial."""
        return (1 if self.jobs is None else self.jobs) * len(self.sweep.seeds)

    @override
    def check(self) -> None:
        if (note := check_parts(self.spec)) is not None:
            self.warn(note)
        self._directions = directions(self.spec)

    @override
    def hear(self, event: RunEvent) -> None:
        """Pass on only warnings: events of the sweep report the ends of trials."""
        if isinstance(event, RunWarned):
            self.listener(event)

    @override
    def execute(self) -> bool:
        self.home = replace(self.home, existing="resume")
        self._base = pinned(self.spec.model_copy(update={"launcher": None}), self.home.runs)
        self._describe()
        journal = self.folder / "journal.log"
        append_lines(journal, ())  # removes an incomplete last line of a killed process
        self._study = Study(journal, self.sweep, self.name, self.spec.training.steps, self._directions)
        stop = self.driver.stop
        with Store(self.home.url) as self._store:
            self._write()
            before = self._record
            self.driver.run(self._trials(), 1 if self.jobs is None else self.jobs)
            self._write()
            final = before.final if self._record.ended == before.ended else None
            is_left = False
            if self.sweep.final is not None and self._record.ranked:
                chosen = None if stop.requested else self._choose()
                is_left = chosen is None and stop.requested
                final = final if is_left else chosen
            self._conclude(final)
        return self._record.best is not None and self._record.ended >= self.asked and not is_left

    def samples(self, number: int) -> Iterator[tuple[dict[str, Any], Spec | KarolosError]]:
        """The values of the first trials with their specs, or the error of one that cannot run."""
        grid = self.sweep.sampler == "grid"
        drawn = list(islice(self.sweep.combinations(), number)) if grid else Study.draws(self.sweep, number)
        for place, values in enumerate(drawn):
            try:
                trial = self._for_search(self.spec, values, f"{self.name}-t{place:03}")
                check_parts(trial)
            except KarolosError as error:
                yield values, error
            else:
                yield values, trial

    def _for_search(self, base: Spec, drawn: Mapping[str, Any], name: str) -> Spec:
        """A trial's spec without the final test, which the search does not use."""
        return spec_of_trial(base, drawn, name, self.sweep.seeds, name).having("testing", final_episodes=0)

    def _trials(self) -> Iterator[TrialJob]:
        """The jobs of open and new trials. A trial that cannot work fails at once."""
        unfinished = self._study.unfinished()
        while not self.driver.stop.requested:
            if unfinished:
                trial = unfinished.pop(0)
            elif len(self._study.trials()) < self.asked:
                trial = self._study.ask()
            else:
                return
            name = self.tell(trial)
            try:
                spec = self._for_search(self._base, trial.drawn, name)
                with self.driver.stop.at_once():
                    check_parts(spec)
            except StopRequestedError:
                return  # the next call of the sweep continues the trial
            except KarolosError as error:
                trial.end(error=str(error).replace("\n", "; "))
                self.tell(trial)
            else:
                yield TrialJob(self, trial, spec)

    def tell(self, trial: OpenTrial) -> str:
        """Write the trials and tell the listener of this one; returns its name."""
        self._write()
        found = self._record.trials[trial.number]
        best = next(iter(self._record.ranked), None)
        self.listener(TrialChanged(found, self._record.ended, self._record.asked, best))
        return found.name

    # The final phase

    def _choose(self) -> SweepFinal | None:
        """Run the best trials on new seeds, choose the best of them, and run it on other new seeds and test episodes.

        The new seeds belong neither to the sweep nor to the spec, and the reporting seeds have no other run. Uses
        finished runs of an earlier call. Returns None if every trial failed on the new seeds, or after a stop request.
        """
        settings, found, stop = self.sweep.final, self._record, self.driver.stop
        assert settings is not None  # the caller sees to it
        unused = self._unused_seeds()
        seeds = tuple(islice(unused, settings.seeds))
        best = found.ranked[: settings.top]
        self.listener(FinalBegan(tuple(trial.number for trial in best), seeds, "choose"))
        fresh = self._values(best, lambda trial: self._for_search(self._base, trial.drawn, trial.name), seeds)
        if stop.requested or not fresh:
            return None
        chosen = min(
            (trial for trial in best if trial.number in fresh),
            key=lambda one: merit(fresh[one.number], found.directions),
        )
        report = self._for_report(self._base, chosen, chosen.name, self.spec.seeds)
        names = {trial.name for trial in found.trials}
        used = {run.seed for run in self._store.runs() if run.name in names and run.experiment != report.hash()}
        report_seeds = tuple(islice((seed for seed in unused if seed not in used), settings.report_seeds))
        self.listener(FinalBegan((chosen.number,), report_seeds, "report"))
        reported = self._values([chosen], lambda _: report, report_seeds)
        if stop.requested:
            return None
        assert chosen.values is not None  # it is complete
        return SweepFinal(chosen.number, seeds, report_seeds, chosen.values, fresh, reported.get(chosen.number))

    def _values(
        self, trials: Sequence[Trial], spec_of: Callable[[Trial], Spec], seeds: tuple[int, ...]
    ) -> dict[int, tuple[float, ...]]:
        """Run specs of trials on these seeds. Returns number -> objectives, without trials that failed on a seed."""
        jobs = {
            trial.number: RunJob(spec_of(trial).model_copy(update={"seeds": seeds}), self.home, together=True)
            for trial in trials
        }
        self.driver.run(jobs.values())
        values = {number: measure_all(self.sweep.objectives, job) for number, job in jobs.items() if job.finished}
        return {number: value for number, value in values.items() if all(map(math.isfinite, value))}

    @staticmethod
    def _for_report(base: Spec, trial: Trial, name: str, seeds: tuple[int, ...]) -> Spec:
        """A trial's spec whose tests play held-out episodes, not those of tuning and choice."""
        spec = spec_of_trial(base, trial.drawn, name, seeds, trial.name)
        return spec.having("testing", seed=spec.testing.seed + REPORT_SEED_OFFSET)

    def _unused_seeds(self) -> Iterator[int]:
        """The first seeds from 0 that belong neither to the sweep nor to the spec."""
        known = {*self.sweep.seeds, *self.spec.seeds}
        return (seed for seed in count() if seed not in known)

    # The folder

    def _describe(self) -> None:
        """Write the spec, and the description with the id and time of the first call.

        Raises UsageError if the folder belongs to a sweep with other settings.
        """
        path = self.folder / "sweep.yaml"
        if path.exists() and _fingerprint(load_spec(path)) != _fingerprint(self.spec):
            raise UsageError(
                f"a sweep {self.name!r} with other settings exists",
                where=str(path),
                hint="give this one another name (name=...), or remove that folder",
            )
        write_whole(path, to_yaml(self.spec.dump()))
        now = datetime.now(UTC)
        identity, created = f"{self.name}-{now:%Y%m%d-%H%M%S}", timestamp(now)
        if (self.folder / DESCRIPTION).exists():
            known = read_sweep_description(self.folder)
            identity, created = known.sweep, known.created
        record = SweepRecord(
            sweep=identity,
            name=self.name,
            experiment=self.spec.hash(),
            objectives=self.sweep.objectives,
            directions=self._directions,
            parameters=tuple(self.sweep.space),
            seeds=self.sweep.seeds,
            asked=self.asked,
            wants_final=self.sweep.final is not None,
            created=created,
            folder=str(self.folder),
        )
        write_json(self.folder / DESCRIPTION, record.description())

    def _write(self) -> None:
        trials = (json.dumps(one.row(), separators=(",", ":"), allow_nan=False) for one in self._study.trials())
        write_whole(self.folder / TRIALS, "".join(f"{line}\n" for line in trials))
        self._record: SweepRecord = read_sweep(self.folder)[0]

    def _conclude(self, final: SweepFinal | None) -> None:
        """Write the result of the final phase (None removes that of an earlier call), the best spec and the figures."""
        from ..report.figures import look, write_plots  # noqa: PLC0415

        path = self.folder / FINAL
        if final is None:
            with writing(path):
                path.unlink(missing_ok=True)
        else:
            write_json(path, final.row())
        self._write()
        self.front = self._study.front()
        if (best := self._record.best) is None:
            return
        seeds = tuple(islice(self._unused_seeds(), len(self.spec.seeds))) if final is None else final.report_seeds
        spec = self._for_report(self.spec, best, best_name(self.name), seeds)
        drawn = ", ".join(f"{key} = {value}" for key, value in best.drawn.items())
        comment = f"# Trial {best.number} of a sweep: {drawn}.\n"
        phases = [(best.values, "the seeds of tuning", self.sweep.seeds)]
        if final is not None:
            phases.append((final.fresh[best.number], "the seeds of the choice", final.seeds))
            phases.append((final.reported, "held-out seeds", final.report_seeds))
        for place, name in enumerate(self.sweep.objectives):
            for values, which, on in phases:
                if values is not None:
                    comment += f"# {name} {values[place]:.4g} on {which} ({', '.join(map(str, on))})\n"
        write_whole(self.folder / BEST, comment + to_yaml(spec.dump()))
        with suppress(StopRequestedError), self.driver.stop.at_once(), look():  # they take seconds
            write_plots(self._study.figures(), self.folder / "figures")


class TrialJob(RunJob):
    """The runs of a trial, which ends as soon as one of them fails."""

    def __init__(self, search: Search, trial: OpenTrial, spec: Spec) -> None:
        super().__init__(spec, search.home, together=True)
        self._search, self._trial = search, trial
        self._reported = 0
        """Number of tests that the pruner has seen."""

    @override
    def heard(self, event: RunEvent) -> str | None:
        """Report the mean at each test that every seed has completed; PRUNED when the pruner stops the trial."""
        sweep = self._search.sweep
        if sweep.pruner is None or not isinstance(event, RunTested) or self.halted:
            return None
        results, settings = self.results(), self.spec
        while (count := self._reported + 1) <= min(len(tests) for tests in results.values()):
            self._reported = count
            last = next(iter(results.values()))[count - 1]
            step = nominal_steps(last.steps, settings.testing.interval, settings.training.steps)
            value = so_far(sweep.objectives[0], results, count)
            if step >= settings.training.steps or not math.isfinite(value):
                continue  # the trial is over, or its value is not a number, which does not prune it
            if self._trial.is_hopeless(value, step):
                return PRUNED
        return None

    @override
    def ended(self) -> None:
        """End the trial. After a stop request it stays open, and the next call of the sweep resumes it."""
        search, objectives = self._search, self._search.sweep.objectives
        runs = [self.summaries[seed].run for seed in self.spec.seeds if seed in self.summaries]
        if self.finished:
            values = measure_all(objectives, self)
            finite = all(math.isfinite(value) for value in values)
            error = None if finite else f"{' and '.join(objectives)} came to {list(values)}"
            self._trial.end(runs, values if finite else None, error)
        elif self.error is not None or self.halted == PRUNED:
            self._trial.end(runs, error=self.error)
        elif not search.driver.stop.requested:
            self._trial.end(runs, error="a run was stopped from outside")
        else:
            return
        search.tell(self._trial)


def _fingerprint(spec: Spec) -> str:
    """A hash of the settings that must be equal in two calls of the same sweep."""
    assert spec.sweep is not None  # only a spec with a sweep has a folder
    search = {key: value for key, value in spec.sweep.model_dump(mode="json").items() if key not in _FREE_SETTINGS}
    return hashlib.sha256(json.dumps([spec.hash(), search], sort_keys=True).encode()).hexdigest()
