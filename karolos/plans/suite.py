"""Trains the specs of a suite, each with its seeds. A budget of time may stop their runs."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from time import monotonic

from typing_extensions import override

from ..errors import PluginError, UsageError, alternatives
from ..evaluation.policies import signature_of
from ..experiment.check import check_parts
from ..experiment.events import RunEvent, RunStarted
from ..experiment.start_from import pinned
from ..launchers.experiment import claim
from ..launchers.runs import RunJob
from ..records import RunFolder
from ..specification import Spec, spec_without
from ..specification.suite import Suite
from .plan import Plan

START_SECONDS, STEPS_PER_SECOND = 10, 330
"""Seconds until a run trains, and median steps per second of the reference runs (docs/results.md) on two cores."""
LONGEST_FOLDER = 100


@dataclass(eq=False)
class SuiteJob(RunJob):
    """The runs of one spec of a suite."""

    budget: Budget | None = None
    """The budget that its one run shares with the runs of other specs."""
    used: float = 0.0
    """Seconds of its one run in earlier commands."""
    cut: str | None = None
    """Why its run did not fit into the budget."""

    @override
    def heard(self, event: RunEvent) -> str | None:
        if self.budget is None:
            return None
        if isinstance(event, RunStarted):
            self.budget.begin(self)
        self.cut = self.cut or self.budget.used_up(self)
        return self.cut

    @override
    def ended(self) -> None:
        if self.budget is not None:
            self.budget.end(self)
        if self.finished:
            self.cut = None


class Budget:
    """Seconds that jobs with one run each, `at_once` at the same time, share by their declared steps.

    A job that waits (`wait`) gets its share when it begins (`begin`). Unused seconds go to later runs.
    """

    def __init__(self, seconds: float, at_once: int, jobs: list[SuiteJob]) -> None:
        self._end = monotonic() + seconds
        self._seconds_per_step = seconds * at_once / _steps(jobs)
        self._left = 0.0
        """Unused seconds of earlier runs."""
        self._waiting: list[SuiteJob] = []
        self._active: dict[SuiteJob, tuple[float, float]] = {}
        """Time at which each active run is stopped (monotonic, s), and its seconds in total."""

    def wait(self, job: SuiteJob, found: RunFolder | None) -> None:
        """Queue a job, unless its run is finished. A job that has used up its share is stopped."""
        if found is not None:
            state = found.state()
            if state.state == "finished":
                return
            job.used = state.total_seconds
            if job.used >= job.spec.training.steps * self._seconds_per_step:
                job.cut, job.summaries[job.spec.seeds[0]] = _cut_after(job.used), found.summary()
                return
        self._waiting.append(job)

    def begin(self, job: SuiteJob) -> None:
        """A run starts. It gets the share of its steps, and its part of the unused seconds."""
        if job not in self._waiting:  # it starts again because its process died
            return
        more = self._left * job.spec.training.steps / _steps(self._waiting)
        share = job.spec.training.steps * self._seconds_per_step + more
        self._left -= more
        self._waiting.remove(job)
        self._active[job] = min(monotonic() + share - job.used, self._end), share

    def used_up(self, job: SuiteJob) -> str | None:
        """Why a run must stop now; None if it need not."""
        end, share = self._active.get(job, (math.inf, 0.0))
        return _cut_after(share) if monotonic() > end else None

    def end(self, job: SuiteJob) -> None:
        end, _ = self._active.pop(job, (monotonic(), 0.0))
        self._left += end - monotonic()


def _cut_after(seconds: float) -> str:
    return f"cut after {seconds:.0f} s, its share of the budget"


def _steps(jobs: Iterable[RunJob]) -> int:
    return sum(job.spec.training.steps for job in jobs)


def too_short(jobs: list[SuiteJob], seconds: float, at_once: int) -> tuple[list[str], str]:
    """The specs whose estimated shares of a budget end before their first test, and a budget that is enough for all."""
    total, least = _steps(jobs), dict[str, float]()
    for job in jobs:
        steps = job.spec.training.steps
        first = START_SECONDS + min(job.spec.testing.interval, steps) / STEPS_PER_SECOND
        least[job.spec.name] = first * total / steps / at_once
    enough = f"at {STEPS_PER_SECOND} steps per second, --budget {math.ceil(max(least.values()) / 60)}m is enough"
    return [name for name, needed in least.items() if needed > seconds], enough


def fitted(suite: Suite, jobs: int = 1) -> Suite:
    """The suite without settings that an override's agent cannot use, and without specs that cannot run.

    Raises:
        KarolosError: no spec can run, one cannot without overrides, either, or none has a measure that is to be shown.
    """
    specs, refused = list[Spec](), dict(suite.refused)
    for spec in suite.specs:
        try:
            specs.append(_fitted(spec, jobs))
        except (UsageError, PluginError) as error:
            refused[spec.name] = error
            if suite.written[spec.name] == spec or len(refused) == len(suite.written):
                raise
    if suite.measures and not refused:
        known = dict.fromkeys(one.name for spec in specs for one in signature_of(spec).measures)
        if unknown := [name for name in suite.measures if name not in known]:
            what, hint = f"no spec has the measure {unknown[0]!r}", alternatives(unknown[0], known)
            raise UsageError(what, where=suite.name, setting="measures", hint=hint)
    return replace(suite, specs=tuple(specs), refused=refused)


def _fitted(spec: Spec, jobs: int) -> Spec:
    try:
        check_parts(spec, jobs)
    except UsageError as error:
        setting, origins = error.setting, spec.origins
        causes = [at for key, at in origins.items() if setting and f"{key}.".startswith(f"{setting}.")]
        own = any(at.startswith("override ") for at in causes)
        if own or not causes or not origins["agent.name"].startswith("override "):
            raise
        less = spec_without(spec, str(setting))
        if less == spec:
            raise
        return _fitted(less, jobs)
    return spec


class SuitePlan(Plan):
    """The specs of a suite, each trained once per seed.

    Args:
        suite: with its specs.
        overrides: those with which it was loaded. They are part of its folder's name: another agent gets another page.
        budget: seconds that the specs share by their steps; only the first seed of each is run.
    """

    what, place = "suite", "suites"

    def __init__(self, suite: Suite, overrides: Sequence[str] = (), budget: float | None = None) -> None:
        self.suite, self.name, self.budget, self.spec = suite, suite.name, budget, suite.specs[0]
        self.label = " ".join(overrides) or suite.name
        words = re.findall(r"[\w.]+", self.label) if overrides else ()
        self.folder_name = "-".join([suite.name, *words])[:LONGEST_FOLDER]
        self.found: list[SuiteJob] = []
        """One for each spec, in their order."""

    @override
    def check(self) -> None:
        """As in `Plan`. Lists settings and specs that overrides leave out. Raises UsageError if launchers differ."""
        self.suite = fitted(self.suite, self.jobs or 1)
        self.spec = self.suite.specs[0]
        for note in self.suite.notes:
            self.warn(note)
        for spec in self.suite.specs:
            if spec.launcher != self.spec.launcher:
                what = f"{self.spec.name} and {spec.name} name different launchers"
                raise UsageError(what, hint="give one with --on")

    @override
    def claim(self, stack: ExitStack) -> None:
        """Claim the seeds, so that no other process runs them."""
        self.found = []
        for spec in self.suite.specs:
            home = self.home.of(spec)
            alone = pinned(spec.alone(), home.runs)
            if self.budget is not None:
                alone = alone.model_copy(update={"seeds": alone.seeds[:1]})
            for seed in alone.seeds:
                claim(home, alone, seed, stack)
            self.found.append(SuiteJob(alone, home))

    @override
    def execute(self) -> bool:
        if self.budget is not None:
            self._share(self.budget, self.jobs or 1)
        self.driver.run([job for job in self.found if job.cut is None])
        return all(job.finished or job.cut is not None for job in self.found) and not self.suite.refused

    def _share(self, seconds: float, at_once: int) -> None:
        """Let the jobs share a budget. Raises UsageError if no run has begun and none would reach its first test."""
        folders = {job: job.home.find(job.spec, job.spec.seeds[0]) for job in self.found}
        late, enough = too_short(self.found, seconds, at_once)
        if late:
            what = f"the share of the budget ends before the first test of {', '.join(late)}"
            if len(late) == len(self.found) and not any(folders.values()):
                raise UsageError(what, where="--budget", hint=enough)
            self.warn(f"{what}; {enough}")
        budget = Budget(seconds, at_once, self.found)
        for job, folder in folders.items():
            job.budget = budget
            budget.wait(job, folder)
