"""A matrix of transfers as tables, heat maps and a page."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import fmean

from ..files import write_whole
from ..records.run_records import RunRecord
from ..report.comparison_figures import heat_map, titled_curve
from ..report.figures import Drawing, look, short, write_figures
from ..report.page import Section, document
from ..report.tables import Columns, Table, count, duration, estimate, interval_notes, reached, success
from .results import METRICS, Cell, Paired, TransferReport, Variant


def matrix_table(report: TransferReport, name: str) -> Table:
    """One metric: a row per source, a column per target."""
    rows = [(source, *map(estimate, found)) for source, found in report.matrix(name)]
    return Table(["from", *(f"to {label}" for label in report.labels)], rows, METRICS[name].title)


def variants_table(report: TransferReport) -> Table:
    """One row per variant: what it costs as a source, and what is possible on it as a target."""
    columns: Columns[Variant] = {
        "variant": lambda one: one.label,
        "success from scratch": lambda one: estimate(one.success),
        f"steps to {report.threshold:g}": lambda one: reached(one.reaching),
        "random policy": lambda one: estimate(one.floor),
        "expert": lambda one: estimate(one.ceiling),
        "steps of a source": lambda one: count(one.steps),
        "its time": lambda one: duration(one.seconds),
    }
    return Table.of(report.variants, columns, "Variants")


def cells_table(report: TransferReport) -> Table:
    """One row per pair of different variants, all metrics."""
    columns: Columns[Cell] = {"transfer": lambda cell: f"{cell.source} to {cell.target}"}
    for name, metric in METRICS.items():
        columns[metric.title.lower()] = partial(_estimate, name)
    columns[f"steps to {report.threshold:g}"] = lambda cell: reached(cell.reaching)
    return Table.of([cell for cell in report.cells if cell.source != cell.target], columns)


def verdict(report: TransferReport) -> str:
    """What the matrix says about transfer between different variants, in a sentence or two."""
    pairs = [cell for cell in report.cells if cell.source != cell.target]
    found = [(one.value, cell) for cell in pairs if (one := cell.estimates.get("zero_shot")) is not None]
    if not found:
        return ""
    low, high = (end(found, key=lambda one: one[0]) for end in (min, max))
    ends = [f"{value:.3f} ({cell.source} to {cell.target})" for value, cell in (low, high)]
    text = f"Zero-shot success: {ends[0]} to {ends[1]}, mean {fmean(value for value, _ in found):.3f}."
    gains = [one.value for cell in pairs if (one := cell.estimates.get("asymptote")) is not None]
    if gains:
        text += (
            f" Fine-tuning ends above training from scratch in {sum(one > 0 for one in gains)} of {len(gains)} pairs."
        )
    return text


def notes(report: TransferReport) -> list[str]:
    """What the numbers mean."""
    lines = [f"{metric.title}: {metric.meaning}" for metric in report.metrics.values()]
    lines += interval_notes(found for cell in report.cells for found in cell.estimates.values())
    for name, metric in report.metrics.items():
        if without := [text for cell in report.cells if (text := _alone(cell, name))]:
            lines.append(f"{metric.title}, pairs that alone have a value: {', '.join(without)}")
    if any(cell.reaching for cell in report.cells):
        lines.append(f"threshold: success at the end of {report.threshold:g} in a test; (k of n): runs that reached it")
    lines.append("random policy, expert: what is possible without learning, with a 95 % Wilson interval")
    return lines


def metric_map(report: TransferReport, name: str) -> Drawing:
    """One metric, a row per source and a column per target; below zero-shot success the expert and random actions."""
    metric, rows = METRICS[name], report.matrix(name)
    if name == "zero_shot":
        rows.append(("expert", [variant.ceiling for variant in report.variants]))
        rows.append(("random", [variant.floor for variant in report.variants]))
    caption = f"{metric.meaning[0].upper()}{metric.meaning[1:]}."
    drawing = Drawing(f"transfer_{name}", metric.title, caption)
    heat_map(drawing, rows, report.labels, neutral=metric.neutral, larger_is_better=metric.larger_is_better)
    drawing.axes.set(xlabel="to", ylabel="from")
    return drawing


@look()
def transfer_figures(report: TransferReport) -> tuple[list[Drawing], list[Drawing]]:
    """A heat map for each metric, and the learning curves on each target."""
    curves = [titled_curve(one, f"Learning on {short(label)}") for label, one in report.learning.items()]
    return [metric_map(report, name) for name in report.metrics], curves


def write_report(report: TransferReport, path: Path, figures: Path | None = None) -> None:
    """Write the page, and the figures into a folder, if one is given. Raises MachineError if that fails."""
    maps, curves = transfer_figures(report)
    write_whole(path, page(report, maps, curves))
    if figures is not None:
        write_figures([*maps, *curves], figures)


def page(report: TransferReport, maps: Sequence[Drawing], curves: Sequence[Drawing]) -> str:
    """The page as text."""
    sections = [
        Section(text=verdict(report), figures=maps),
        Section("In numbers", table=cells_table(report), notes=notes(report)),
        Section("Sources and targets", table=variants_table(report)),
        *([Section("Learning", figures=curves)] if curves else []),
        Section("Runs", table=_runs_table(report)),
    ]
    return document(f"Transfer: {report.name}", f"seeds {', '.join(map(str, report.seeds))}", sections, report.warnings)


def _runs_table(report: TransferReport) -> Table:
    """Every run and zero-shot test with its Wilson interval."""
    rows: list[tuple[str, ...]] = []
    for variant in report.variants:
        rows += [(f"{variant.label}, from scratch", *_run_cells(run)) for run in variant.runs.values()]
    for cell in report.cells:
        name = f"{cell.source} to {cell.target}"
        for seed, test in cell.tests.items():
            rows.append((f"{name}, zero-shot", str(seed), success(test.success_end, test.episodes), "-", "-"))
        rows += [(f"{name}, fine-tuned", *_run_cells(run)) for run in cell.runs.values()]
    return Table(["what", "seed", "success end", "steps", "run"], rows)


def _run_cells(run: RunRecord) -> tuple[str, str, str, str]:
    summary = run.summary
    return str(summary.seed), success(run.reported("end"), run.episodes), count(summary.steps), summary.run


def _alone(cell: Cell, name: str) -> str:
    """How many pairs of a cell alone have a value; nothing if all have."""
    found = cell.estimates.get(name)
    if not isinstance(found, Paired) or found.alone == found.pairs:
        return ""
    return f"{cell.source} to {cell.target} {found.alone} of {found.pairs}"


def _estimate(name: str, cell: Cell) -> str:
    return estimate(cell.estimates.get(name))
