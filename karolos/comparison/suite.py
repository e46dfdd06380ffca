"""The numbers of a suite: one entry for each spec, alone or beside other runs of the same name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..errors import RunError
from ..launchers.suite import SuiteRuns
from ..records import RunFolder, scan
from ..records.run_records import THRESHOLD
from ..specification import Spec
from ..statistics.aggregates import median_reaching
from .contenders import ComparedRun, Contender, load_compared, one_per_seed
from .scores import Comparison, Reaching, Scores, compare


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
    def runs(self) -> tuple[ComparedRun, ...]:
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
    measures: tuple[str, ...]
    warnings: tuple[str, ...]

    def rows(self) -> list[dict[str, Any]]:
        """One JSON object per spec, as `karolos compare` gives it, with the row of the other runs in `beside`."""
        return [self._row(entry) for entry in self.entries]

    def _row(self, entry: Entry) -> dict[str, Any]:
        *other, own = entry.comparison.rows()
        return {
            "suite": self.name,
            "spec": entry.spec.name,
            "task": entry.task,
            "robot": entry.robot,
            "agent": entry.spec.agent.name,
            "to_95": entry.reaching and asdict(entry.reaching),
            "cut": entry.cut,
            **own,
            "beside": other[0] if other else None,
        }


def suite_report(
    found: SuiteRuns, label: str, beside: Path | None = None, experiments: Mapping[str, str] | None = None
) -> SuiteReport:
    """The numbers of a suite's runs.

    Args:
        found: the runs.
        label: of these runs.
        beside: folder of other runs; those named as a spec stand beside it.
        experiments: name of a spec -> hash of the experiment that is meant, if the folder has several of that name;
            by default the suite's own.
    """
    entries, warnings = [], dict[str, list[str]]()
    other = None if beside is None else beside.name if beside.name != label else f"{beside.name}/"
    for job in found.jobs:
        spec, problems = job.spec, list[str]()
        folders = [RunFolder.open(job.summaries[seed].folder) for seed in spec.seeds if seed in job.summaries]
        runs = tuple(run for run in (load_compared(folder.record()) for folder in folders) if run.tests)
        if not runs:
            warnings.setdefault("no test yet", []).append(spec.name)
            continue
        contenders = [Contender(label, runs)]
        if beside is not None and other is not None:
            mine = {folder.path.resolve() for folder in folders}
            theirs = _runs_beside(spec.name, beside, mine, (experiments or {}).get(spec.name, spec.hash()), problems)
            contenders[:0] = [Contender(other, theirs)] if theirs else []
        comparison = compare(contenders)
        for warning in (*problems, *comparison.warnings):
            warnings.setdefault(warning, []).append(spec.name)
        reaching = Reaching(
            THRESHOLD,
            sum(run.summary.steps_to_95 is not None for run in runs),
            len(runs),
            median_reaching([run.summary.steps_to_95 for run in runs]),
            median_reaching([run.summary.seconds_to_95 for run in runs]),
        )
        reached = reaching if contenders[-1].has_success else None
        entries.append(Entry(spec, comparison, reached, found.cut.get(spec.name)))
    known = {name for entry in entries for name in entry.comparison.measures}
    warnings |= {"no spec has these measures": missing} if (missing := sorted({*found.suite.measures} - known)) else {}
    said = [f"{warning} ({', '.join(names)})" for warning, names in warnings.items()]
    return SuiteReport(found.suite.name, label, other, tuple(entries), found.suite.measures, (*found.problems, *said))


def _runs_beside(
    name: str, folder: Path, mine: set[Path], experiment: str, problems: list[str]
) -> tuple[ComparedRun, ...]:
    """The tested runs of this name, one for each seed: those of the experiment, or of the only one there is."""
    opened = (one for one in scan(folder, f"{name}*") if not isinstance(one, RunError))
    named = [one for one in opened if one.description()["name"] == name and one.path.resolve() not in mine]
    found = {experiment} & {one.description()["experiment"] for one in named}
    found = found or {one.description()["experiment"] for one in named}
    if len(found) != 1:
        problems.append(f"{folder} has {len(found) or 'no'} experiments of this name, so nothing stands beside it")
        return ()
    runs = {
        run.summary.run: run
        for run in (load_compared(one.record()) for one in named if one.description()["experiment"] in found)
        if run.tests
    }
    chosen = one_per_seed([run.summary for run in runs.values()])
    return tuple(runs[chosen[seed].run] for seed in sorted(chosen))
