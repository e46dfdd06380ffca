"""The report of a suite: numbers of each spec, with other runs of its name if given; tables, figures and a page."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import partial
from os.path import relpath
from pathlib import Path
from statistics import fmean
from typing import Any

from ..comparison import Comparison, Contender, Estimate, compare
from ..comparison.contenders import one_per_seed
from ..comparison.differences import differences
from ..comparison.scores import Reaching, Scores, reaching
from ..errors import UsageError
from ..records import RunFolder, scan
from ..records.run_records import THRESHOLD, RunRecord
from ..report.comparison_figures import heat_map, titled_curve
from ..report.figures import Drawing, look
from ..report.page import Section, document
from ..report.tables import (
    Columns,
    Table,
    against_first,
    count,
    counted,
    decimals,
    duration,
    estimate,
    heading,
    interval_notes,
    reached,
    runs_table,
)
from ..specification import Spec
from .suite import SuitePlan


@dataclass(frozen=True)
class Entry:
    """Results of the runs of one spec."""

    spec: Spec
    comparison: Comparison
    """The other runs, if any, and the suite's."""
    reaching: Reaching | None
    """When the suite's runs reached a success of .95; None if the environment defines no success."""
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
        return self.comparison.contenders[-1].runs

    @property
    def scores(self) -> Scores:
        return self.comparison.scores[-1]

    @property
    def beside(self) -> Scores | None:
        """The scores of the other runs; None without any."""
        return self.comparison.scores[0] if len(self.comparison.scores) > 1 else None

    def row(self) -> dict[str, Any]:
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
    """Names the suite's runs."""
    beside: str | None
    """Names the other runs."""
    entries: tuple[Entry, ...]
    """The specs with a test, in their order."""
    untested: tuple[str, ...]
    measures: tuple[str, ...]
    warnings: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    """Settings and specs that the overrides leave out, see `Suite.notes`."""

    def rows(self) -> list[dict[str, Any]]:
        """One JSON object per spec, as in `karolos compare`, with the row of the other runs under `beside`."""
        return [{"suite": self.name} | entry.row() for entry in self.entries]


def suite_report(plan: SuitePlan, beside: Path | None = None) -> SuiteReport:
    """The numbers of a suite's runs.

    Args:
        plan: the suite, after its runs.
        beside: folder of other runs. A spec is compared with the runs of its name. If these belong to several
            experiments, the one with the suite's settings without overrides counts.
    """
    suite, label = plan.suite, plan.label
    entries, untested, warnings = [], list[str](), defaultdict[str, list[str]](list)
    other = None if beside is None else beside.name
    if other == label:
        other += "/"  # two contenders need different labels
    for job in plan.found:
        spec = job.spec
        records = [RunFolder.open(job.summaries[seed].folder).record() for seed in spec.seeds if seed in job.summaries]
        runs = _tested(records)
        if not runs:
            untested.append(spec.name)
            continue
        contenders = [Contender(label, runs)]
        if beside is not None and other is not None:
            written = suite.written.get(spec.name, spec).hash()
            others = _beside(beside, spec.name, written, contenders[0])
            if isinstance(others, str):
                warnings[others].append(spec.name)
            else:
                # another plugin counts as one setting
                found = differences([{**one, "name": "", "seeds": []} for one in (others[0].spec, spec.dump())])
                keys = {key.partition(".")[0] if f"{key.partition('.')[0]}.name" in found else key for key in found}
                if keys:
                    warnings[f"{other} has other settings: {', '.join(sorted(keys))}"].append(spec.name)
                contenders.insert(0, Contender(other, others))
        comparison = compare(contenders)
        for warning in comparison.warnings:
            warnings[warning].append(spec.name)
        reached = reaching(runs, "end", THRESHOLD) if contenders[-1].has_success else None
        entries.append(Entry(spec, comparison, reached, job.cut))
    warnings |= {"no test yet": untested} if untested else {}
    unknown = {*suite.measures}.difference(*(entry.comparison.measures for entry in entries))
    warnings |= {"no spec has these measures": sorted(unknown)} if unknown else {}
    said = [f"{warning} ({', '.join(names)})" for warning, names in warnings.items()]
    problems = [line for job in plan.found for line in job.problems(job.cut)]
    done, without = tuple(entries), tuple(untested)
    return SuiteReport(suite.name, label, other, done, without, suite.measures, (*problems, *said), suite.notes)


def _tested(records: Iterable[RunRecord]) -> tuple[RunRecord, ...]:
    return tuple(record for record in records if record.tests)


def _beside(folder: Path, name: str, experiment: str, own: Contender) -> tuple[RunRecord, ...] | str:
    """The runs of a name in a folder, without the suite's own: of the experiment or of the only one; or why none.

    One run per seed.
    """
    mine = {run.summary.folder for run in own.runs}
    records = [one.record() for one in scan(folder, f"{name}*") if isinstance(one, RunFolder)]
    records = [one for one in records if one.summary.name == name and one.summary.folder not in mine]
    found = {record.summary.experiment for record in records}
    found = found & {experiment} or found
    if len(found) != 1:
        return f"{folder} has {len(found) or 'no'} experiments of this name, so it is not compared"
    runs = {run.summary.run: run for run in _tested(records) if run.summary.experiment in found}
    chosen = one_per_seed([run.summary for run in runs.values()])
    others = tuple(runs[chosen[seed].run] for seed in sorted(chosen))
    steps = max(run.tests[-1].steps for run in own.runs)
    try:  # a shorter run is compared with the others at the same steps
        others = tuple(run if run.tests[-1].steps <= 1.1 * steps else run.at(steps) for run in others)
    except UsageError:
        return f"{folder} has no test near the last one of a run that ended sooner, so it is not compared"
    return others or f"{folder} has no test of this name"


def _grid(report: SuiteReport) -> tuple[list[str], list[tuple[str, list[Estimate | None]]]]:
    """The robots, and each task with its success for each robot."""
    cells = {(entry.task, entry.robot): entry.scores.end for entry in report.entries}
    robots, tasks = (list(dict.fromkeys(key[part] for key in cells)) for part in (1, 0))
    return robots, [(task, [cells.get((task, robot)) for robot in robots]) for task in tasks]


def grid_table(report: SuiteReport) -> Table:
    """Success at the end of the episode: a row per task, a column per robot."""
    robots, rows = _grid(report)
    return Table(["task", *robots], [(task, *map(estimate, cells)) for task, cells in rows], "success end")


def entries_table(report: SuiteReport) -> Table:
    """One row per spec: its success, that of the other runs, and cost."""
    columns: Columns[Entry] = {
        "spec": lambda one: one.spec.name,
        "seeds": lambda one: str(len(one.runs)),
        "success end": lambda one: estimate(one.scores.end),
        "return": lambda one: estimate(one.scores.returns) if one.scores.end is None else "-",
        str(report.beside): lambda one: estimate((one.beside.end or one.beside.returns) if one.beside else None),
        f"better than {report.beside}": lambda one: estimate(one.scores.improvement, 2),
        "steps to .95": lambda one: reached(one.reaching),
        "time to .95": lambda one: reached(one.reaching, "seconds"),
        "steps": lambda one: count(one.scores.steps),
        "time": lambda one: duration(one.scores.seconds),
        "budget": lambda one: one.cut or "",
    }
    return Table.of(report.entries, columns)


def measures_table(report: SuiteReport) -> Table:
    """One row per spec, one column per measure."""
    found = {name: one for entry in report.entries for name, one in entry.comparison.measures.items()}
    columns: Columns[Entry] = {"spec": lambda one: one.spec.name}
    for name, one in found.items():
        if name in report.measures or not report.measures:
            columns[heading(name, one)] = partial(_measure, name)
    return Table.of(report.entries if len(columns) > 1 else [], columns, "measures")


def _measure(name: str, entry: Entry) -> str:
    found = entry.scores.measures.get(name)
    return estimate(found, decimals(found.value) if found else 0)


def verdict(report: SuiteReport) -> str:
    """Summary of the suite, in a few sentences."""
    runs = [run.summary for entry in report.entries for run in entry.runs]
    text = f"{counted(len(runs), 'run')} took {count(sum(run.steps for run in runs))} environment steps"
    text += f" and {duration(sum(run.total_seconds or run.seconds for run in runs))}, tests included."
    if ends := [entry.scores.end.value for entry in report.entries if entry.scores.end is not None]:
        reached = [one.reaching.reached if one.reaching is not None else 0 for one in report.entries]
        solved = sum(seeds == len(one.spec.seeds) for seeds, one in zip(reached, report.entries, strict=True))
        text += f" Success at the end: {min(ends):.3f} to {max(ends):.3f}, mean {fmean(ends):.3f}."
        specs = len(report.entries) + len(report.untested)
        text += f" {solved} of {specs} specs reached .95 in a test with every seed."
    if report.untested:
        text += f" Without a test: {', '.join(report.untested)}."
    compared = [(one.spec.name, found) for one in report.entries if (found := one.scores.improvement) is not None]
    if better := [found.value for _, found in compared if against_first(found) not in ("few", "unknown")]:
        text += f" A run is better than one of {report.beside} with probability {fmean(better):.2f}, mean over"
        text += f" specs with 5 seeds of each ({len(better)}); .5: no difference."
    if few := [name for name, found in compared if against_first(found) == "few"]:
        text += f" Too few seeds to tell from {report.beside} (5 of each are needed): {', '.join(few)}."
    return text


def notes(report: SuiteReport) -> list[str]:
    lines = ["success and measures are those of the last policy in the final test, or in the last test without one"]
    lines.append("steps and time to .95: median over seeds of the first test with that success; (k of n) reached it")
    scores = [one for entry in report.entries for one in (entry.scores, entry.beside) if one is not None]
    return lines + interval_notes(found for one in scores for found in (one.end, one.returns))


def suite_page(report: SuiteReport, folder: Path) -> str:
    """The page as text. Links to the runs are relative to the page's folder."""
    with look():
        robots, rows = _grid(report)
        grid = Drawing("suite", "Success at the end of the episode", "Mean over the seeds.")
        grid.figure.set_figheight(1.2 + 0.3 * len(rows))
        if succeeds := any(one.scores.end for one in report.entries):
            heat_map(grid, rows, robots)
        curves = [titled_curve(one.comparison, one.spec.name) for one in report.entries]
    runs = [run.summary for entry in report.entries for run in entry.runs]
    measures = measures_table(report)
    sections = [
        Section(text=verdict(report), figures=[grid] if succeeds else []),
        Section("Tasks and robots", table=grid_table(report)),
        Section("In numbers", table=entries_table(report), notes=notes(report)),
        *([Section("Measures", table=measures)] if measures.rows else []),
        Section("Learning", figures=curves),
        Section("Runs", table=runs_table(runs), links=[relpath(run.folder, folder) for run in runs]),
    ]
    what = f"{report.label}, beside {report.beside}" if report.beside else report.label
    return document(f"Suite: {report.name}", what, sections, [*report.left_out, *report.warnings])
