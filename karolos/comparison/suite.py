"""The numbers of a suite: one entry for each spec, alone or beside other runs of the same name."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..errors import UsageError
from ..launchers.suite import SuiteRuns
from ..records import RunFolder, scan
from ..records.run_records import THRESHOLD, RunRecord
from ..specification import Spec
from .contenders import Contender, one_per_seed
from .differences import differences
from .scores import Comparison, Reaching, Scores, compare, reaching


@dataclass(frozen=True)
class Entry:
    """What the runs of one spec achieved."""

    spec: Spec
    comparison: Comparison
    """The other runs, if there are any, and the suite's."""
    reaching: Reaching | None
    """When the suite's runs reached .95; None without success."""
    cut: str | None
    """Why its run did not fit into the budget."""

    @property
    def robot(self) -> str:
        """Name of the robot, or of an environment without one."""
        return self.spec.robot.name if self.spec.robot is not None else self.spec.environment.name

    @property
    def task(self) -> str:
        """The spec's name without the robot's."""
        return self.spec.name.removeprefix(f"{self.robot}_")

    @property
    def runs(self) -> tuple[RunRecord, ...]:
        """The suite's runs."""
        return self.comparison.contenders[-1].runs

    @property
    def scores(self) -> Scores:
        """Of the suite's runs."""
        return self.comparison.scores[-1]

    @property
    def beside(self) -> Scores | None:
        """Of the other runs."""
        return self.comparison.scores[0] if len(self.comparison.scores) > 1 else None

    def row(self) -> dict[str, Any]:
        """The entry as JSON values."""
        *other, own = self.comparison.rows()
        return {
            "spec": self.spec.name,
            "task": self.task,
            "robot": self.robot,
            "agent": self.spec.agent.name,
            "to_95": self.reaching and asdict(self.reaching),
            "cut": self.cut,
            **own,
            "beside": other[0] if other else None,
        }


@dataclass(frozen=True)
class SuiteReport:
    """The numbers of a suite."""

    name: str
    label: str
    """Of the suite's runs."""
    beside: str | None
    """Of the others."""
    entries: tuple[Entry, ...]
    """Of the specs with a test, in their order."""
    untested: tuple[str, ...]
    """Names of the others."""
    measures: tuple[str, ...]
    warnings: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    """Settings and specs that the overrides leave no place for, see `Suite.notes`."""

    def rows(self) -> list[dict[str, Any]]:
        """One JSON object per spec, as `karolos compare` gives it, with the row of the other runs in `beside`."""
        return [{"suite": self.name} | entry.row() for entry in self.entries]


def suite_report(found: SuiteRuns, label: str, beside: Path | None = None) -> SuiteReport:
    """The numbers of a suite's runs.

    Args:
        found: the runs.
        label: of these runs.
        beside: folder of other runs; those named as a spec stand beside it. If it has several experiments of the name,
            the one with the settings that the suite has without overrides is meant.
    """
    entries, untested, warnings = [], list[str](), defaultdict[str, list[str]](list)
    other = None if beside is None else f"{beside.name}{'/' * (beside.name == label)}"
    for job in found.jobs:
        spec = job.spec
        records = [RunFolder.open(job.summaries[seed].folder).record() for seed in spec.seeds if seed in job.summaries]
        runs = _tested(records)
        if not runs:
            untested.append(spec.name)
            continue
        contenders = [Contender(label, runs)]
        if beside is not None and other is not None:
            written = found.suite.written.get(spec.name, spec).hash()
            others = _beside(beside, spec.name, written, contenders[0])
            if isinstance(others, str):
                warnings[others].append(spec.name)
            else:
                warnings[_unlike(other, others[0].spec, spec)].append(spec.name)
                contenders.insert(0, Contender(other, others))
        comparison = compare(contenders)
        for warning in comparison.warnings:
            warnings[warning].append(spec.name)
        reached = reaching(runs, "end", THRESHOLD) if contenders[-1].has_success else None
        entries.append(Entry(spec, comparison, reached, found.cut.get(spec.name)))
    warnings |= {"no test yet": untested} if untested else {}
    unknown = {*found.suite.measures}.difference(*(entry.comparison.measures for entry in entries))
    warnings |= {"no spec has these measures": sorted(unknown)} if unknown else {}
    said = [f"{warning} ({', '.join(names)})" for warning, names in warnings.items() if warning]
    return SuiteReport(
        found.suite.name,
        label,
        other,
        tuple(entries),
        tuple(untested),
        found.suite.measures,
        (*found.problems, *said),
        found.suite.notes,
    )


def _unlike(label: str, other: Mapping[str, Any], spec: Spec) -> str:
    """Which settings runs beside the suite's have otherwise; empty if none. Another plugin is one setting."""
    found = differences([{**one, "name": "", "seeds": []} for one in (other, spec.dump())])
    keys = {key.partition(".")[0] if f"{key.partition('.')[0]}.name" in found else key for key in found}
    return f"{label} has other settings: {', '.join(sorted(keys))}" if keys else ""


def _tested(records: Iterable[RunRecord]) -> tuple[RunRecord, ...]:
    return tuple(record for record in records if record.tests)


def _beside(folder: Path, name: str, experiment: str, own: Contender) -> tuple[RunRecord, ...] | str:
    """The runs of a name in a folder but the suite's own: of the experiment, or of the only one; or why there are none.

    Of each seed there is one.
    """
    mine = {run.summary.folder for run in own.runs}
    records = [one.record() for one in scan(folder, f"{name}*") if isinstance(one, RunFolder)]
    records = [one for one in records if one.summary.name == name and one.summary.folder not in mine]
    found = {record.summary.experiment for record in records}
    found = found & {experiment} or found
    if len(found) != 1:
        return f"{folder} has {len(found) or 'no'} experiments of this name, so nothing stands beside it"
    runs = {run.summary.run: run for run in _tested(records) if run.summary.experiment in found}
    chosen = one_per_seed([run.summary for run in runs.values()])
    others = tuple(runs[chosen[seed].run] for seed in sorted(chosen))
    steps = max(run.tests[-1].steps for run in own.runs)
    try:  # beside a shorter run stands what the others were then
        others = tuple(run if run.tests[-1].steps <= 1.1 * steps else run.at(steps) for run in others)
    except UsageError:
        return f"{folder} has no test near the last one of a run that ended sooner, so nothing stands beside it"
    return others or f"{folder} has no test of this name"
