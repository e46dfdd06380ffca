"""What is compared: experiments, each with one run per seed."""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

from ..errors import RunError, UsageError
from ..records import RunFolder
from ..records.results import TestCounts
from ..records.run_records import RunRecord, RunSummary
from ..records.sweep_records import best_name
from ..store import Store

Success = Literal["any", "end"]
"""How success is counted: the goal is reached at any step, or at the last step."""
Metric = Literal["any", "end", "return"]
"""What is compared: the success ratio, or the mean return."""

LISTED = 5


@dataclass(frozen=True)
class ComparedRun:
    """One run with its tests. Settings, versions and commit come from its folder, if that still exists."""

    summary: RunSummary
    tests: tuple[TestCounts, ...]
    spec: Mapping[str, Any]
    versions: Mapping[str, str]
    commit: str | None
    """Git commit, with a + when files differed from it."""

    @property
    def has_success(self) -> bool:
        """Whether a test says how many episodes succeed."""
        return self.summary.success_end is not None or any(test.successes_end is not None for test in self.tests)

    def values(self, metric: Metric) -> tuple[float, ...]:
        """Success ratio or mean return of each test."""
        if metric == "return":
            return tuple(math.nan if test.mean_return is None else test.mean_return for test in self.tests)
        return tuple((getattr(test, f"successes_{metric}") or 0) / test.episodes for test in self.tests)

    def reported(self, metric: Metric) -> float:
        """Success ratio or mean return of the final test's policy `last`; without a final test, of the last test.

        nan of a return that is not finite.
        """
        summary = self.summary
        final = {"any": summary.success_any, "end": summary.success_end, "return": summary.mean_return}[metric]
        if summary.final and (final is not None or metric == "return"):
            return math.nan if final is None else final
        return self.values(metric)[-1]

    def measured(self, name: str) -> float | None:
        """The mean of a measure over the episodes of the test that `reported` is of; None if it is unknown."""
        measure = self.summary.measures.get(name)
        return None if measure is None else measure["mean"]

    @cached_property
    def final_values(self) -> Mapping[str, tuple[float, ...]]:
        """Each measure in the episodes of the final test in which it is defined; empty if no folder holds it."""
        with suppress(RunError):
            final = RunFolder.open(self.summary.folder).final()
            if final is not None and self.summary.final:
                measures = final.last.measures.items()
                return {name: tuple(x for x in one["values"] if x is not None) for name, one in measures}
        return {}

    @property
    def episodes(self) -> int:
        """Episodes of the test that `reported` is of."""
        return (self.summary.episodes if self.summary.final else None) or self.tests[-1].episodes

    @property
    def finished(self) -> bool:
        return self.summary.state == "finished"

    @property
    def updates_per_second(self) -> float | None:
        """Gradient updates per second of collecting and learning; None if they are unknown."""
        updates, seconds = self.summary.updates, self.summary.seconds
        return updates / seconds if updates is not None and seconds else None

    def at(self, steps: int) -> ComparedRun:
        """The run as it was at its test nearest to this number of environment steps.

        Raises UsageError if that is more than a tenth away.
        """
        nearest = min(self.tests, key=lambda test: abs(test.steps - steps))
        if abs(nearest.steps - steps) > steps / 10:
            raise UsageError(
                f"{self.summary.run} has no test near {steps:,} steps",
                where="--at",
                hint=f"its nearest is at {nearest.steps:,}; name a number of steps at which all runs were tested",
            )
        tests = tuple(test for test in self.tests if test.steps <= nearest.steps)
        summary = replace(
            self.summary,
            state="finished",
            steps=nearest.steps,
            seconds=nearest.seconds,
            updates=None,  # tests do not say
            success_any=nearest.success_any,
            success_end=nearest.success_end,
            mean_return=nearest.mean_return,
            episodes=nearest.episodes,
            measures=nearest.measures,
            final=False,
            best_steps=None,
            best_any=None,
            best_end=None,
            best_return=None,
        )
        return replace(self, summary=summary, tests=tests)


@dataclass(frozen=True)
class Contender:
    """An experiment with its runs that have a test, one per seed, in the order of the seeds.

    Args:
        label: its name in tables and figures.
        runs: at least one.
        problems: warnings about the choice of runs, one line each.
    """

    label: str
    runs: tuple[ComparedRun, ...]
    problems: tuple[str, ...] = ()

    @property
    def has_success(self) -> bool:
        """Whether the success of its runs is known."""
        return any(run.has_success for run in self.runs)

    @property
    def experiment(self) -> str:
        return self.runs[0].summary.experiment

    @property
    def spec(self) -> Mapping[str, Any]:
        """Resolved spec of its first run. The others have the same experiment hash."""
        return self.runs[0].spec


def gather(store: Store | None, runs: Sequence[RunSummary], label: str) -> Contender:
    """A contender from runs of one experiment. Of several runs with the same seed, it has the newest finished one.

    Of the runs of a sweep, only those on seeds that its settings were not tuned or chosen on count, if there are any.
    Without a store the runs are read from their folders, and all count.

    Raises:
        UsageError: the runs belong to several experiments, or no run has a test yet.
    """
    if store is None:
        records = [RunFolder.open(run.folder).record() for run in runs]
        return _contender(label, records, [])
    runs, problems = _reporting(store, runs, label)
    experiments = sorted({run.experiment for run in runs})
    if len(experiments) > 1:
        shown = ", ".join(experiment[:12] for experiment in experiments[:LISTED])
        more = f" and {len(experiments) - LISTED} more" if len(experiments) > LISTED else ""
        raise UsageError(
            f"{label} means {len(experiments)} experiments, whose specs differ, or files that they name",
            hint=f"name one by its hash: {shown}{more}",
        )
    chosen = one_per_seed(runs)
    problems += repeated(label, runs)
    return _contender(label, store.records([chosen[seed] for seed in sorted(chosen)]), problems)


def _contender(label: str, records: Sequence[RunRecord], problems: list[str]) -> Contender:
    """The contender of those runs that have a test; the others are one problem more."""
    loaded = [load_compared(record) for record in records]
    tested = tuple(run for run in loaded if run.tests)
    if not tested:
        raise UsageError(f"{label} has no test yet", hint="`karolos runs list` shows how far its runs are")
    untested = [run.summary.run for run in loaded if not run.tests]
    if untested:
        problems.append(f"{label}: left out, because they have no test: {', '.join(untested)}")
    return Contender(label, tested, tuple(problems))


def one_per_seed(runs: Sequence[RunSummary]) -> dict[int, RunSummary]:
    """Seed -> of its runs the newest finished one, or the newest if none is finished.

    Of runs whose plugins have other source than the newest of these, none counts.
    """
    ordered = sorted(runs, key=lambda run: (run.state == "finished", run.created))
    source = next((run.source for run in reversed(ordered) if run.source), None)
    return {run.seed: run for run in ordered if run.source in (None, source)}


def averaged(runs: Sequence[RunSummary]) -> tuple[list[RunSummary], str]:
    """The runs that means in lists are of, one per seed: the finished ones, or all if none is; and what is left out."""
    seeds = list(one_per_seed(runs).values())
    finished = [run for run in seeds if run.state == "finished"] or seeds
    cut = len(seeds) - len(finished)
    return finished, f"{cut} of {len(seeds)} seeds not finished, left out" if cut else ""


def name_of(runs: Sequence[RunSummary]) -> str:
    """The names that people gave the runs of an experiment, the newest first: a name is not part of its identity."""
    return ", ".join(dict.fromkeys(run.name for run in runs))


def repeated(label: str, runs: Sequence[RunSummary]) -> list[str]:
    """Warnings if `one_per_seed` leaves out runs: those of other source, and those that repeat a seed."""
    chosen = one_per_seed(runs).values()
    sources = {None, *(run.source for run in chosen)}
    others = [run.run for run in runs if run.source not in sources]
    more = len(runs) - len(others) - len(chosen)
    rule = "of each seed the newest finished run is used, or the newest if none is finished"
    edited = "a plugin or module of theirs was another one, see `karolos diff`"
    found = [f"{label}: {more} of {len(runs)} runs repeat a seed; {rule}"] if more else []
    return found + ([f"{label}: left out, because {edited}: {', '.join(others)}"] if others else [])


def labels_of(selected: Sequence[Sequence[RunSummary]]) -> list[str]:
    """A label for each of some selections of runs: its name. Of several with one name: name and hash, or a run's id."""
    names = [name_of(found) for found in selected]
    labels = []
    for name, (run, *others) in zip(names, selected, strict=True):
        distinct = f"{name} {run.experiment[:8]}" if others else run.run
        labels.append(name if names.count(name) == 1 else distinct)
    return labels


def _reporting(store: Store, runs: Sequence[RunSummary], label: str) -> tuple[Sequence[RunSummary], list[str]]:
    """The runs that say how good they are, or all if none does, and what to note.

    Of a sweep's trial those on its reporting seeds do, of its best spec those on seeds that it did not tune or choose
    on, and runs of no sweep.
    """
    sweeps = store.sweeps.all()[::-1]  # the newest of a name last
    trials = {trial.name: (record, trial.number) for record in sweeps for trial in record.trials}
    bests = {best_name(record.name): record for record in sweeps}
    reporting: list[RunSummary] = []
    others: defaultdict[str, set[int]] = defaultdict(set)  # sweep -> seeds of its other runs
    for run in runs:
        if run.name in trials:
            record, number = trials[run.name]
            reports = record.final and record.final.chosen == number and run.seed in record.final.report_seeds
        elif run.name in bests:
            record = bests[run.name]
            reports = run.seed not in {*record.seeds, *(record.final.seeds if record.final else ())}
        else:
            reporting.append(run)
            continue
        if reports:
            reporting.append(run)
        else:
            others[record.name].add(run.seed)
    if not reporting:
        biased = "tuned or chose its settings by these runs, so their success is biased upwards"
        return runs, [f"{label}: the sweep {name} {biased}" for name in others]
    return reporting, [
        f"{label}: only the seeds that the sweep {name} reports on count; it tuned or chose the settings on"
        f" {', '.join(map(str, sorted(seeds)))}"
        for name, seeds in others.items()
    ]


def load_compared(record: RunRecord) -> ComparedRun:
    """A run of the index or of a folder, with what only its folder holds."""
    about: Mapping[str, Any] = {}
    spec: Mapping[str, Any] = {}
    if os.path.isdir(record.summary.folder):
        with suppress(RunError):  # a damaged folder; the index has everything that a comparison needs
            folder = RunFolder.open(record.summary.folder)
            about, spec = folder.description(), folder.spec()
    return ComparedRun(record.summary, record.tests, spec or record.spec, record.versions, _commit(about))


def _commit(about: Mapping[str, Any]) -> str | None:
    git = about.get("git") or {}
    return f"{git['commit'][:8]}{'+' if git.get('dirty') else ''}" if git.get("commit") else None
