"""A suite as tables, figures and a page."""

from __future__ import annotations

from functools import partial
from os.path import relpath
from pathlib import Path
from statistics import fmean

from ..comparison import Estimate
from ..comparison.suite import Entry, SuiteReport
from ..files import write_whole, writing
from .comparison_figures import heat_map, titled_curve
from .figures import Drawing, look
from .page import Section, document
from .tables import (
    Columns,
    Table,
    against_first,
    count,
    decimals,
    duration,
    estimate,
    heading,
    interval_notes,
    reached,
    runs_table,
)


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
    """One row per spec: success, beside that of the other runs, and cost."""
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
    """What the suite says, in a few sentences."""
    runs = [run.summary for entry in report.entries for run in entry.runs]
    text = f"{len(runs)} runs took {count(sum(run.steps for run in runs))} environment steps"
    text += f" and {duration(sum(run.total_seconds or run.seconds for run in runs))}, tests included."
    if ends := [entry.scores.end.value for entry in report.entries if entry.scores.end is not None]:
        reached = [one.reaching.reached if one.reaching is not None else 0 for one in report.entries]
        solved = sum(seeds == len(one.spec.seeds) for seeds, one in zip(reached, report.entries, strict=True))
        text += f" Success at the end: {min(ends):.3f} to {max(ends):.3f}, mean {fmean(ends):.3f}."
        specs = len(report.entries) + len(report.untested)
        text += f" {solved} of {specs} specs reached .95 in a test with every seed."
    if report.untested:
        text += f" Without a test: {', '.join(report.untested)}."
    beside = [(one.spec.name, found) for one in report.entries if (found := one.scores.improvement) is not None]
    if better := [found.value for _, found in beside if against_first(found) not in ("few", "unknown")]:
        text += f" A run is better than one of {report.beside} with probability {fmean(better):.2f}, mean over"
        text += f" specs with 5 seeds of each ({len(better)}); .5: no difference."
    if few := [name for name, found in beside if against_first(found) == "few"]:
        text += f" Too few seeds to tell from {report.beside} (5 of each are needed): {', '.join(few)}."
    return text


def notes(report: SuiteReport) -> list[str]:
    """What the numbers mean."""
    lines = ["success and measures are those of the last policy in the final test, or in the last test without one"]
    lines.append("steps and time to .95: median over seeds of the first test with that success; (k of n) reached it")
    scores = [one for entry in report.entries for one in (entry.scores, entry.beside) if one is not None]
    return lines + interval_notes(found for one in scores for found in (one.end, one.returns))


def write_report(report: SuiteReport, path: Path) -> None:
    """Write the page. Raises MachineError if that fails."""
    with look():
        robots, rows = _grid(report)
        grid = Drawing("suite", "Success at the end of the episode", "Mean over the seeds.")
        grid.figure.set_figheight(1.2 + 0.3 * len(rows))
        if succeeds := any(one.scores.end for one in report.entries):
            heat_map(grid, rows, robots)
        curves = [titled_curve(one.comparison, one.spec.name) for one in report.entries]
    runs = [run.summary for entry in report.entries for run in entry.runs]
    sections = [
        Section(text=verdict(report), figures=[grid] if succeeds else []),
        Section("Tasks and robots", table=grid_table(report)),
        Section("In numbers", table=entries_table(report), notes=notes(report)),
        *([Section("Measures", table=measures)] if (measures := measures_table(report)).rows else []),
        Section("Learning", figures=curves),
        Section("Runs", table=runs_table(runs), links=[relpath(run.folder, path.parent) for run in runs]),
    ]
    beside = f", beside {report.beside}" if report.beside else ""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(
        path,
        document(f"Suite: {report.name}", f"{report.label}{beside}", sections, [*report.left_out, *report.warnings]),
    )
