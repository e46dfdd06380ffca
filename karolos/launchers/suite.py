"""Trains the specs of a suite: ordinary runs of one driver.

The run folders are all that there is: a resumed suite has no state of its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import monotonic

from typing_extensions import override

from ..errors import PluginError, UsageError
from ..experiment.events import Listener, RunEvent, RunStarted, RunWarned
from ..experiment.start_from import pinned
from ..specification import Spec, spec_without
from ..specification.suite import Suite
from ..training.assembly import check_parts
from .driver import Feed, driving
from .experiment import claim
from .runs import Existing, Home, RunJob

START_SECONDS, STEPS_PER_SECOND = 10, 330
"""What a run takes until it trains, and the median of the reference runs (docs/results.md) on two cores."""


@dataclass
class SuiteRuns:
    """The runs of a suite. After a stop some are missing."""

    suite: Suite
    jobs: list[RunJob]
    """One for each spec, in their order."""
    cut: dict[str, str] = field(default_factory=dict)
    """Name of a spec that did not fit into the budget -> why its run was stopped."""
    stop_code: int = 0

    @property
    def problems(self) -> list[str]:
        """Which runs did not finish, and why."""
        ended = [(job, summary) for job in self.jobs for summary in job.summaries.values()]
        return [
            ": ".join(filter(None, (f"{run.run} is {run.state}", self.cut.get(job.spec.name) or run.error)))
            for job, run in ended
            if run.state != "finished"
        ]

    @property
    def exit_code(self) -> int:
        """0 if all specs ran, to the end or until cut, else 1; after a stop 128 + signal, or 124 for the time limit."""
        whole = all(job.finished or job.spec.name in self.cut for job in self.jobs)
        return self.stop_code or int(not whole or bool(self.suite.refused))


class Shares(Feed[RunJob]):
    """Jobs of one run each that share a budget by their declared steps. What a job leaves goes to those after it.

    Args:
        jobs: in the order in which they start.
        seconds: of the budget, for so many runs at the same time.
        at_once: runs at the same time.
    """

    def __init__(self, jobs: list[RunJob], seconds: float, at_once: int) -> None:
        self.cut: dict[str, str] = {}
        self._at_once, steps, waiting = at_once, _steps(jobs), list(jobs)
        self._used: dict[RunJob, float] = {}
        """Seconds that the waiting runs took before, in another command."""
        self._ends: dict[RunJob, tuple[float, float]] = {}
        """When the active runs are stopped, and the seconds that each has in all."""
        for job in jobs:
            share = seconds * at_once * job.spec.training.steps / steps
            found = job.home.find(job.spec, job.spec.seeds[0])
            state = found.state() if found is not None else None
            if found is not None and state is not None and state.state != "finished" and state.total_seconds >= share:
                job.read_tests(job.spec.seeds[0], found)
                job.summaries[job.spec.seeds[0]] = found.summary()
                self._cut(job, state.total_seconds)
                waiting.remove(job)
            elif state is None or state.state != "finished":
                self._used[job] = state.total_seconds if state is not None else 0.0
        rest = seconds * _steps(self._used) / steps - sum(self._used.values()) / at_once
        self._end = monotonic() + rest
        super().__init__(*waiting)

    def _cut(self, job: RunJob, seconds: float) -> str:
        return self.cut.setdefault(job.spec.name, f"cut after {seconds:.0f} s, its share of the budget")

    @override
    def heard(self, job: RunJob, event: RunEvent) -> str | None:
        now = monotonic()
        if isinstance(event, RunStarted) and job in self._used:
            left = (self._end - now) * self._at_once - sum(max(0.0, end - now) for end, _ in self._ends.values())
            share = max(0.0, (left + sum(self._used.values())) * job.spec.training.steps / _steps(self._used))
            self._ends[job] = min(now + share - self._used.pop(job), self._end), share
        end, share = self._ends.get(job, (now, 0.0))
        return self._cut(job, share) if now > end else None

    @override
    def ended(self, job: RunJob) -> None:
        self._ends.pop(job, None)
        if job.finished:
            self.cut.pop(job.spec.name, None)


def without_test(jobs: list[RunJob], seconds: float, at_once: int) -> str | None:
    """Which specs' shares of a budget end before their first test, as far as one can tell; None: no spec's."""
    total, least = _steps(jobs), dict[str, float]()
    for job in jobs:
        steps = job.spec.training.steps
        first = START_SECONDS + min(job.spec.testing.interval, steps) / STEPS_PER_SECOND
        least[job.spec.name] = first * total / steps / at_once
    if not (late := [name for name, needed in least.items() if needed > seconds]):
        return None
    share = f"the share of the budget ends before the first test of {', '.join(late)}"
    return f"{share}; at {STEPS_PER_SECOND} steps per second, --budget {math.ceil(max(least.values()) / 60)}m is enough"


def _steps(jobs: Iterable[RunJob]) -> int:
    """The environment steps that some jobs declare."""
    return sum(job.spec.training.steps for job in jobs)


def fitted(suite: Suite, jobs: int = 1) -> Suite:
    """The suite without settings of its files that an override's agent cannot use, and without specs that cannot run.

    Raises:
        KarolosError: no spec can run, or one cannot without overrides, either.
    """
    specs, refused = list[Spec](), dict(suite.refused)
    for spec in suite.specs:
        try:
            specs.append(_fitted(spec, jobs))
        except (UsageError, PluginError) as error:
            refused[spec.name] = error
            if suite.written[spec.name] == spec or len(refused) == len(suite.written):
                raise
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


def train(
    suite: Suite,
    runs: str | Path = "runs",
    *,
    database: str | None = None,
    jobs: int | None = None,
    existing: Existing = "ignore",
    time_limit: float | None = None,
    budget: float | None = None,
    listener: Listener = lambda _: None,
) -> SuiteRuns:
    """Train every spec, once per seed.

    Args:
        suite: with its specs, `fitted`.
        runs: folder of the run folders.
        database: SQLAlchemy URL of the results database.
        jobs: runs at the same time, each in its own process; None: one, or with another launcher than `local` as many
            as it has room for.
        existing: what to do with existing runs, as for `Experiment.run`.
        time_limit: seconds after which to stop.
        budget: seconds that the specs share by their steps; only the first seed of each is run.
        listener: is called with every RunEvent.

    Raises:
        UsageError: the specs name different launchers.
        RunError: another process has a seed of a spec, and `existing` is not "ignore".
        MachineError: the runs folder cannot be written, or processes cannot be started.
        StoreError: the database cannot be used.
    """
    first = suite.specs[0]
    for spec in suite.specs:
        if spec.launcher != first.launcher:
            raise UsageError(f"{first.name} and {spec.name} name different launchers", hint="give one with --on")
    with ExitStack() as stack:
        driver = stack.enter_context(driving(first, jobs, listener, time_limit))
        found = SuiteRuns(suite, [])
        for spec in suite.specs:
            home = Home.prepared(spec, runs, database, existing)
            alone = pinned(spec.alone(), home.runs)
            if budget is not None:
                alone = alone.model_copy(update={"seeds": alone.seeds[:1]})
            for seed in alone.seeds:
                claim(home, alone, seed, stack)
            found.jobs.append(RunJob(alone, replace(home, text=spec.text)))
        shares = None if budget is None else Shares(found.jobs, budget, jobs or 1)
        if budget is not None and (late := without_test(found.jobs, budget, jobs or 1)) is not None:
            listener(RunWarned(suite.name, late))
        driver.run(shares or Feed(*found.jobs))
        found.cut = shares.cut if shares else {}
        if not all(job.finished or job.spec.name in found.cut for job in found.jobs):
            found.stop_code = driver.stop.exit_code
    return found
