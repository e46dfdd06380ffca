"""The contenders of a comparison: experiments with one run per seed, and warnings about unintended differences."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..errors import UsageError
from ..records import RunFolder
from ..records.run_records import RunRecord, RunSummary
from ..records.sweep_records import SweepRecord, read_sweep, sweep_folder
from ..simulation.engines import ENGINES
from ..store import Store

LISTED = 5


@dataclass(frozen=True)
class Contender:
    """An experiment with its runs that have a test, one per seed, in the order of the seeds.

    Args:
        label: its name in tables and figures.
        runs: at least one.
        problems: warnings about the choice of runs, one line each.
    """

    label: str
    runs: tuple[RunRecord, ...]
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


def gather(store: Store | None, runs: Sequence[RunSummary], label: str, selector: str | None = None) -> Contender:
    """A contender from runs of one experiment. If several runs have the same seed, it has the newest finished one.

    Runs of a sweep count only on new seeds, on which no setting was tuned or chosen, if there are such runs. Without a
    store the runs are read from their folders, and all count.

    Errors name the `selector` that a person typed, by default the label.

    Raises UsageError if the runs belong to several experiments, or no run has a test yet.
    """
    if store is None:
        return _contender(label, [RunFolder.open(run.folder).record() for run in runs], [], selector)
    runs, problems = _reporting(runs, label)
    experiments = sorted({run.experiment for run in runs})
    if len(experiments) > 1:
        shown = ", ".join(experiment[:12] for experiment in experiments[:LISTED])
        more = f" and {len(experiments) - LISTED} more" if len(experiments) > LISTED else ""
        raise UsageError(
            f"{selector or label} means {len(experiments)} experiments, whose specs differ, or files that they name",
            hint=f"name one by its hash: {shown}{more}",
        )
    chosen = one_per_seed(runs)
    problems += repeated(label, runs)
    return _contender(label, store.records([chosen[seed] for seed in sorted(chosen)]), problems, selector)


def _contender(label: str, records: Sequence[RunRecord], problems: list[str], selector: str | None) -> Contender:
    """The contender of the runs that have a test. The other runs become one more problem."""
    tested = tuple(run for run in records if run.tests)
    if not tested:
        raise UsageError(f"{selector or label} has no test yet", hint="`karolos runs list` shows how far its runs are")
    if untested := [run.summary.run for run in records if not run.tests]:
        problems.append(f"{label}: left out, because they have no test: {', '.join(untested)}")
    return Contender(label, tested, tuple(problems))


def one_per_seed(runs: Sequence[RunSummary]) -> dict[int, RunSummary]:
    """Seed -> the newest finished run with it, or the newest run if none is finished.

    Runs whose plugins have other source than those of the newest run do not count.
    """
    ordered = sorted(runs, key=lambda run: (run.state == "finished", run.created))
    source = next((run.source for run in reversed(ordered) if run.source), None)
    return {run.seed: run for run in ordered if run.source in (None, source)}


def averaged(runs: Sequence[RunSummary]) -> tuple[list[RunSummary], str]:
    """The runs over which lists take means, one per seed (finished ones, or all if none is), and what is left out."""
    seeds = list(one_per_seed(runs).values())
    finished = [run for run in seeds if run.state == "finished"] or seeds
    cut = len(seeds) - len(finished)
    return finished, f"{cut} of {len(seeds)} seeds not finished, left out" if cut else ""


def name_of(runs: Sequence[RunSummary]) -> str:
    """The names of an experiment's runs, newest first: a name is not part of an experiment's identity."""
    return ", ".join(dict.fromkeys(run.name for run in runs))


def repeated(label: str, runs: Sequence[RunSummary]) -> list[str]:
    """Warnings if `one_per_seed` leaves out runs: runs of other source, and runs that repeat a seed."""
    chosen = one_per_seed(runs).values()
    sources = {None, *(run.source for run in chosen)}
    others = [run.run for run in runs if run.source not in sources]
    more = len(runs) - len(others) - len(chosen)
    rule = "of each seed the newest finished run is used, or the newest if none is finished"
    edited = "they used other code of a plugin or module, see `karolos diff`"
    found = [f"{label}: {more} of {len(runs)} runs repeat a seed; {rule}"] if more else []
    return found + ([f"{label}: left out, because {edited}: {', '.join(others)}"] if others else [])


def labels_of(selected: Sequence[Sequence[RunSummary]]) -> list[str]:
    """A label for each selection of runs: its name. If several have the same name: name and hash, or a run's id."""
    names = [name_of(found) for found in selected]
    labels = []
    for name, (run, *others) in zip(names, selected, strict=True):
        distinct = f"{name} {run.experiment[:8]}" if others else run.run
        labels.append(name if names.count(name) == 1 else distinct)
    return labels


def _reporting(runs: Sequence[RunSummary], label: str) -> tuple[Sequence[RunSummary], list[str]]:
    """The runs whose results are not biased by choosing them, or all if there are none, and what to note.

    Unbiased are: runs of a sweep's trial on its reporting seeds, runs of its best spec on seeds that the sweep did not
    use, and runs that do not belong to a sweep.
    """
    sweeps: dict[Path, SweepRecord] = {}
    reporting: list[RunSummary] = []
    others: defaultdict[str, set[int]] = defaultdict(set)  # sweep -> seeds of its other runs
    for run in runs:
        folder = sweep_folder(run)
        if folder is not None and folder not in sweeps:
            sweeps[folder], _ = read_sweep(folder)
        if folder is None or sweeps[folder].reports(run.name, run.seed):
            reporting.append(run)
        else:
            others[sweeps[folder].name].add(run.seed)
    if not reporting:
        biased = "tuned or chose its settings by these runs, so their success is biased upwards"
        return runs, [f"{label}: the sweep {name} {biased}" for name in others]
    return reporting, [
        f"{label}: only the seeds that the sweep {name} reports on count; it tuned or chose the settings on"
        f" {', '.join(map(str, sorted(seeds)))}"
        for name, seeds in others.items()
    ]


def cautions(contenders: Sequence[Contender]) -> tuple[str, ...]:
    """One line per warning, the most important first."""
    found = [problem for contender in contenders for problem in contender.problems]
    found += _different(contenders, "they do different tasks", _task)
    found += _different(contenders, "different physics engines (environment.engine)", _engine)
    for contender in contenders:
        if left := [run.summary for run in contender.runs if not run.finished]:
            named = ", ".join(f"{run.run} {run.state} at {run.steps:,} steps" for run in left)
            found.append(f"{contender.label}: {len(left)} of {len(contender.runs)} runs are not finished: {named}")
    found += _different(contenders, "they ended at different steps", lambda run: f"{run.tests[-1].steps:,}")
    for contender in contenders:
        if unknown := [run.summary.run for run in contender.runs if math.isnan(run.reported("return"))]:
            found.append(f"{contender.label}: no finite return, so no mean is known: {', '.join(unknown)}")
    counts = [len(contender.runs) for contender in contenders]
    if len(set(counts)) > 1:
        found.append(f"unequal numbers of seeds: {_each(contenders, counts)}")
    found += _different(contenders, "tests of different numbers of episodes", lambda run: run.episodes)
    found += _different(
        contenders, "figures of different tests", lambda run: "final test" if run.summary.final else "last test"
    )
    what = "tests on different episodes (testing.seed)"
    found += _different(contenders, what, lambda run: (run.spec.get("testing") or {}).get("seed"))
    what = "tests at different intervals, which steps to a ratio depend on (testing.interval)"
    found += _different(contenders, what, lambda run: (run.spec.get("testing") or {}).get("interval"))
    for name in sorted({name for contender in contenders for run in contender.runs for name in run.versions}):
        found += _different(contenders, f"different versions of {name}", partial(_version, name))
    found += _different(contenders, "made from different code (git commit, + with changes)", lambda run: run.commit)
    return tuple(found)


def _different(contenders: Sequence[Contender], what: str, of: Callable[[RunRecord], object]) -> list[str]:
    """One line if the values of the runs differ. Unknown values (None) are ignored."""
    values = [
        sorted({str(value) for value in map(of, contender.runs) if value is not None}) for contender in contenders
    ]
    if len({value for listed in values for value in listed}) < 2:
        return []
    return [f"{what}: {_each(contenders, [' and '.join(listed) or 'not known' for listed in values])}"]


def _each(contenders: Sequence[Contender], values: Sequence[object]) -> str:
    return "; ".join(f"{contender.label} {value}" for contender, value in zip(contenders, values, strict=True))


def _version(package: str, run: RunRecord) -> str | None:
    """The version of a package; None for an engine that the run did not use."""
    engine = _engine(run)
    others = [one.package for one in ENGINES.values() if engine is not None and one.name != engine]
    return None if package in others else run.versions.get(package)


def _engine(run: RunRecord) -> str | None:
    """The physics engine; None for an environment without one."""
    environment: Mapping[str, str] = run.spec.get("environment") or {}
    return environment.get("engine")


def _task(run: RunRecord) -> str | None:
    """Name of the task, or of the environment and its id if there is no task."""
    name = run.summary.task or run.summary.environment
    environment = run.spec.get("environment")
    if run.summary.task or not isinstance(environment, Mapping) or "id" not in environment:
        return name
    return f"{name} {environment['id']}"
