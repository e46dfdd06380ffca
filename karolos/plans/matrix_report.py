"""The report of a matrix of transfers: numbers, tables, heat maps and a page.

The seed is the unit, and source, target and fine-tuning are paired by it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from statistics import fmean
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..comparison import aggregates
from ..comparison.contenders import Contender
from ..comparison.curves import places
from ..comparison.reaching import first_reaching
from ..comparison.scores import Comparison, Estimate, Reaching, compare, estimate, reaching
from ..core.seeding import SeedTree
from ..environments.build import used
from ..environments.robot_task import RobotTask
from ..evaluation.policies import environment_of
from ..records import RunFolder
from ..records.evaluation import Evaluation
from ..records.run_records import RunRecord
from ..report import tables
from ..report.comparison_figures import heat_map, titled_curve
from ..report.figures import HEIGHT, WIDTH, Drawing, file_name, look, short
from ..report.page import Section, document
from ..report.tables import Columns, Table, count, duration, interval_notes, reached, success
from . import transfer
from .matrix import Matrix, Pair


@dataclass(frozen=True)
class TransferMetric:
    """A metric of a cell: its name, explanation and shading."""

    title: str
    meaning: str
    neutral: float | None = None
    """Value without shade; larger values are blue, smaller ones red. None: shades from 0 to 1."""
    larger_is_better: bool = True


GOOD = 0.9
"""Success on an arm that counts as doing the task."""
MANY = 6
"""Targets from which on a map has a row for each."""
PICTURE = 480, 360
"""Size in pixels of the picture of a target."""
METRICS = {
    "zero_shot": TransferMetric(
        "Zero-shot success",
        "the source's best policy on the target, in the held-out episodes of the final test; on the "
        "diagonal on its own variant",
    ),
    "retention": TransferMetric(
        "Retention", "zero-shot success, divided by the success of the same policies on their own variant"
    ),
    "fine_tuned": TransferMetric(
        "Success after fine-tuning", "the last policy of fine-tuning on the target, in its final test"
    ),
    "jump_start": TransferMetric(
        "Jump-start",
        "success of fine-tuning minus that of training from scratch at the first step at which both have been tested "
        "(Taylor and Stone 2009)",
        neutral=0.0,
    ),
    "asymptote": TransferMetric(
        "Asymptote",
        "success of fine-tuning minus that of training from scratch, each at its own end (Taylor and Stone 2009)",
        neutral=0.0,
    ),
    "time_ratio": TransferMetric(
        "Time to threshold",
        "median steps of fine-tuning to the threshold, divided by those from scratch (Kaplan-Meier over seeds: a run "
        "that never reaches it is censored at its end); \N{INFINITY}: fine-tuning has no median, 0: training from "
        "scratch has none; the steps of the source are not counted",
        neutral=1.0,
        larger_is_better=False,
    ),
    "forward_transfer": TransferMetric(
        "Forward transfer",
        "(AUC - AUC of scratch) / (1 - AUC of scratch); AUC is the mean success between the first and the last step at "
        "which both were tested (Wolczyk et al. 2021, Continual World)",
        neutral=0.0,
    ),
}


@dataclass(frozen=True)
class Paired(Estimate):
    """An estimate over pairs of runs, or of tests, of one seed each."""

    pairs: int
    alone: int
    """Number of pairs with a value of their own; smallest and largest are taken over these. A ratio by 0 has no value,
    and forward transfer has none if training from scratch leaves nothing to gain."""


@dataclass(frozen=True)
class Cell:
    """Transfer from a source to a target. On the diagonal only `zero_shot` is known."""

    source: str
    target: str
    estimates: Mapping[str, Estimate | None]
    """Metrics by their names in METRICS, without those whose runs or tests are missing."""
    reaching: Reaching | None
    """Steps at which fine-tuning reached the threshold."""
    tests: Mapping[int, Evaluation]
    """Seed -> zero-shot test."""
    runs: Mapping[int, RunRecord]
    """Seed -> fine-tuned run."""


@dataclass(frozen=True)
class Variant:
    """A variant as a source, and as training from scratch on a target."""

    label: str
    runs: Mapping[int, RunRecord]
    """Seed -> finished run."""
    success: Estimate | None
    """Results after its own training."""
    reaching: Reaching | None
    steps: float
    """Environment steps of a run, mean over seeds: the cost of a source."""
    seconds: float
    """Seconds of collecting and learning, mean over seeds."""
    floor: Estimate | None
    """Success of uniformly random actions; None where the task refuses the robot."""
    ceiling: Estimate | None
    """Success of the scripted expert."""
    refused: str | None = None
    """Why the robot and the task do not go together."""


@dataclass(frozen=True)
class TransferReport:
    """The numbers of a matrix."""

    name: str
    threshold: float
    seeds: tuple[int, ...]
    variants: tuple[Variant, ...]
    cells: tuple[Cell, ...]
    """Cells by source, including the diagonal."""
    learning: Mapping[str, Comparison]
    """Target -> training from scratch and fine-tuning from each source."""
    warnings: tuple[str, ...]

    @property
    def labels(self) -> list[str]:
        return [variant.label for variant in self.variants]

    @property
    def sources(self) -> list[str]:
        return list(dict.fromkeys(cell.source for cell in self.cells))

    @property
    def metrics(self) -> dict[str, TransferMetric]:
        """The metrics that at least one cell has."""
        return {name: one for name, one in METRICS.items() if any(cell.estimates.get(name) for cell in self.cells)}

    def matrix(self, name: str) -> list[tuple[str, list[Estimate | None]]]:
        """One metric: each source with an estimate per target."""
        return [
            (source, [cell.estimates.get(name) for cell in self.cells if cell.source == source])
            for source in self.sources
        ]

    def rows(self) -> list[dict[str, Any]]:
        """One JSON object per pair of source and target."""
        by_label = {variant.label: variant for variant in self.variants}
        return [self._row(cell, by_label[cell.source], by_label[cell.target]) for cell in self.cells]

    def _row(self, cell: Cell, source: Variant, target: Variant) -> dict[str, Any]:
        estimates = {name: (found := cell.estimates.get(name)) and asdict(found) for name in METRICS}
        if estimates["zero_shot"]:
            counts = cell.tests.values()
            estimates["zero_shot"] |= {
                "each": [count.success_end for count in counts],
                "wilson": [count.interval(count.successes_end or 0) for count in counts],
            }
        return {
            "matrix": self.name,
            "source": cell.source,
            "target": cell.target,
            "seeds": list(cell.tests),
            **estimates,
            "threshold": self.threshold,
            "steps_to_threshold": _reaching_row(cell.reaching),
            "scratch": {
                "success_end": target.success and asdict(target.success),
                "steps_to_threshold": _reaching_row(target.reaching),
                "runs": [run.summary.run for run in target.runs.values()],
                "experiment": next((run.summary.experiment for run in target.runs.values()), None),
            },
            "floor": target.floor and target.floor.value,
            "ceiling": target.ceiling and target.ceiling.value,
            "source_cost": {"steps": source.steps, "seconds": source.seconds},
            "source_runs": [run.summary.run for run in source.runs.values()],
            "fine_tuned_seeds": list(cell.runs),
            "fine_tuned_runs": [run.summary.run for run in cell.runs.values()],
            "refused": target.refused,
            "warnings": list(self.warnings),
        }


def _reaching_row(found: Reaching | None) -> dict[str, Any] | None:
    return None if found is None else {"median": found.steps, "reached": found.reached, "of": found.seeds}


def transfer_report(found: Matrix) -> TransferReport:
    """The numbers of a matrix, from its runs and tests."""
    settings = found.transfer
    tree, threshold = SeedTree(0).child("transfer"), settings.threshold
    untested: list[str] = []
    scratch = {label: _compared(found.sources.get(label, {}), untested) for label in found.variants}
    tuned = {pair: _compared(runs, untested) for pair, runs in found.fine_tuned.items()}
    tests = {pair: dict(each) for pair, each in found.zero_shot.items()}
    for (source, _), each in found.zero_shot.items():  # a test on any target includes the test on the own variant
        tests.setdefault((source, source), {}).update({seed: test.own for seed, test in each.items() if test.own})
    cells = []
    for source, target in product(settings.source_names, scratch):
        pair, leaf = (source, target), tree.child(source, target)
        baseline = scratch[target] if "scratch" in settings.modes else {}
        runs, counts = tuned.get(pair, {}), tests.get(pair, {})
        estimates = _zero_shot(counts, {} if source == target else tests.get((source, source), {}), leaf)
        estimates |= _fine_tuned(runs, baseline, threshold, leaf)
        cells.append(Cell(source, target, estimates, _reaching(runs, threshold), counts, runs))
    return TransferReport(
        name=found.spec.name,
        threshold=threshold,
        seeds=found.spec.seeds,
        variants=tuple(
            Variant(
                label,
                runs,
                success=_reported(runs, tree.child(label)),
                reaching=_reaching(runs, threshold),
                steps=_mean([run.summary.steps for run in runs.values()]),
                seconds=_mean([run.summary.seconds for run in runs.values()]),
                floor=_wilson(known.floor) if (known := found.baselines.get(label)) else None,
                ceiling=_wilson(known.ceiling) if known and known.ceiling else None,
                refused=found.refused.get(label),
            )
            for label, runs in scratch.items()
        ),
        cells=tuple(cells),
        learning={label: _learning(label, runs, tuned) for label, runs in scratch.items() if runs and tuned},
        warnings=(*found.problems, *(f"{run} has lost its tests and is left out" for run in untested)),
    )


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else 0.0


def _wilson(test: Evaluation) -> Estimate:
    successes = test.successes_end or 0
    return Estimate(successes / test.episodes, *test.interval(successes), "wilson")


def _compared(runs: Mapping[int, RunFolder], untested: list[str]) -> dict[int, RunRecord]:
    """The runs that have tests; notes the others."""
    tested = {seed: folder for seed, folder in runs.items() if folder.tests()}
    untested += (folder.id for seed, folder in runs.items() if seed not in tested)
    return {seed: folder.record() for seed, folder in tested.items()}


def _reported(runs: Mapping[int, RunRecord], tree: SeedTree) -> Estimate | None:
    """Success of the last policies."""
    if not runs:
        return None
    reported = [run.reported("end") for run in runs.values()]
    return estimate([reported], aggregates.mean, tree, next(iter(runs.values())).episodes)


def _zero_shot(
    tests: Mapping[int, Evaluation], own: Mapping[int, Evaluation], tree: SeedTree
) -> dict[str, Estimate | None]:
    """The estimates of a cell from tests of the source's policies on the target, and on their own variant."""
    if not tests:
        return {}
    ends, episodes = [count.success_end or 0.0 for count in tests.values()], next(iter(tests.values())).episodes
    estimates: dict[str, Estimate | None] = {}
    estimates["zero_shot"] = estimate([ends], aggregates.mean, tree.child("zero shot"), episodes)
    if own:
        before = [own[seed].success_end or 0.0 for seed in tests]
        rows = list(zip(ends, before, strict=True))
        estimates["retention"] = _paired(rows, transfer.ratio_of_means, tree.child("retention"))
    return estimates


def _fine_tuned(
    runs: Mapping[int, RunRecord], scratch: Mapping[int, RunRecord], threshold: float, tree: SeedTree
) -> dict[str, Estimate | None]:
    """The estimates of a cell from fine-tuning. Comparisons use the seeds that both sides have."""
    reported = _reported(runs, tree.child("fine tuned"))
    if reported is None:
        return {}
    estimates: dict[str, Estimate | None] = {"fine_tuned": reported}
    pairs = [(runs[seed], scratch[seed]) for seed in runs if seed in scratch]
    if not pairs:
        return estimates
    firsts, areas, ends = [], [], []
    for tuned, baseline in pairs:
        curves = [(places(run, "steps"), np.array(run.values("end"))) for run in (tuned, baseline)]
        start, end = max(at[0] for at, _ in curves), min(at[-1] for at, _ in curves)
        firsts.append([transfer.area_under_curve(*curve, start, start) for curve in curves])
        areas.append([transfer.area_under_curve(*curve, start, max(start, end)) for curve in curves])
        ends.append([tuned.reported("end"), baseline.reported("end")])
    times = [[*_time(tuned, threshold), *_time(baseline, threshold)] for tuned, baseline in pairs]
    compared: Any = (
        ("jump_start", firsts, _difference),
        ("asymptote", ends, _difference),
        ("forward_transfer", areas, transfer.forward_transfer),
        ("time_ratio", times, transfer.median_time_ratio),
    )
    for name, rows, statistic in compared:
        estimates[name] = _paired(rows, statistic, tree.child(name))
    return estimates


def _paired(
    rows: Sequence[Sequence[float]], statistic: Callable[..., NDArray[np.float64]], tree: SeedTree
) -> Paired | None:
    """`estimate` of the values of some pairs (n, k)."""
    columns = np.array(rows, float).T
    found, alone = estimate(columns.tolist(), statistic, tree), statistic(*columns[..., None])
    return None if found is None else Paired(**vars(found), pairs=len(rows), alone=int(np.sum(~np.isnan(alone))))


def _difference(values: NDArray[np.float64], baseline: NDArray[np.float64]) -> NDArray[np.float64]:
    return aggregates.mean(values - baseline)


def _time(run: RunRecord, threshold: float) -> tuple[float, bool]:
    """Steps at which a run reached the threshold or, without reaching it, ended; and whether it reached it."""
    at = places(run, "steps").tolist()
    reached = first_reaching(run.values("end"), at, threshold)
    return (at[-1], False) if reached is None else (reached, True)


def _reaching(found: Mapping[int, RunRecord], threshold: float) -> Reaching | None:
    return reaching(list(found.values()), "end", threshold) if found else None


def _learning(
    target: str, scratch: Mapping[int, RunRecord], tuned: Mapping[Pair, Mapping[int, RunRecord]]
) -> Comparison:
    """Training from scratch on a target, and fine-tuning there from each source."""
    contenders = [Contender(f"{target} from scratch", tuple(scratch.values()))]
    for (source, on), runs in tuned.items():
        if on == target and runs:
            contenders.append(Contender(f"from {source}", tuple(runs.values())))
    return compare(contenders, "end")


def matrix_table(report: TransferReport, name: str) -> Table:
    """One metric: a row per source, a column per target; for many targets a row per target."""
    rows = [(source, *map(tables.estimate, found)) for source, found in report.matrix(name)]
    columns = ["from", *(f"to {label}" for label in report.labels)]
    if len(report.labels) > MANY:
        columns = ["to", *(f"from {source}" for source, *_ in rows)]
        rows = list(zip(report.labels, *(cells for _, *cells in rows), strict=True))
    return Table(columns, rows, METRICS[name].title)


def variants_table(report: TransferReport) -> Table:
    """One row per variant: its cost as a source, and the reachable success on it as a target."""
    columns: Columns[Variant] = {
        "variant": lambda one: one.label,
        "success from scratch": lambda one: tables.estimate(one.success),
        f"steps to {report.threshold:g}": lambda one: reached(one.reaching),
        "random policy": lambda one: tables.estimate(one.floor),
        "expert": lambda one: tables.estimate(one.ceiling),
        "steps of a source": lambda one: count(one.steps),
        "its time": lambda one: duration(one.seconds),
        "refused": lambda one: one.refused or "",
    }
    return Table.of(report.variants, columns, "Variants")


def targets_table(found: Sequence[tuple[str, str, float | None, str | None]], of: str) -> Table:
    """A row for each policy. The arm is the unit: mean over arms with its interval, least, and which arms cannot.

    Args:
        found: policy, arm, success there if it is known, and why the arm does not do the task.
        of: what the rows are of.
    """
    rows = []
    for policy in dict.fromkeys(policy for policy, *_ in found):
        here = [one[1:] for one in found if one[0] == policy]
        known = sorted((success, arm) for arm, success, _ in here if success is not None)
        values = [success for success, _ in known]
        mean = estimate([values], aggregates.mean, SeedTree(0).child("arms", policy)) if values else None
        good = f"{sum(value >= GOOD for value in values)} of {len(here)}"
        least = "{:.2f} {}".format(*known[0]) if known else "-"
        cannot = "; ".join(f"{arm}: {reason}" for arm, _, reason in here if reason)
        rows.append((policy, str(len(values)), tables.estimate(mean), least, good, cannot))
    return Table([of, "arms", "mean", "least", f"{GOOD:g} or more", "cannot"], rows, "Over arms")


def over_targets(report: TransferReport) -> list[Table]:
    """`targets_table` of each source, of own training, experts and random actions; none if all targets are sources."""
    if report.sources == report.labels:
        return []
    found = [
        (cell.source, cell.target, cell.estimates.get("zero_shot"))
        for cell in report.cells
        if cell.source != cell.target
    ]
    for one in report.variants:
        for what, known in (("own training", one.success), ("expert", one.ceiling), ("random actions", one.floor)):
            found += [(what, one.label, known)] if known else []
    refused = {one.label: one.refused for one in report.variants}
    return [targets_table([(a, b, one.value if one else None, refused[b]) for a, b, one in found], "policy")]


def cells_table(report: TransferReport) -> Table:
    """One row per pair of different variants, all metrics."""
    columns: Columns[Cell] = {"transfer": lambda cell: f"{cell.source} to {cell.target}"}
    for name, metric in METRICS.items():
        columns[metric.title.lower()] = partial(_shown, name)
    columns[f"steps to {report.threshold:g}"] = lambda cell: reached(cell.reaching)
    return Table.of([cell for cell in report.cells if cell.source != cell.target], columns)


def _shown(name: str, cell: Cell) -> str:
    return tables.estimate(cell.estimates.get(name))


def verdict(report: TransferReport) -> str:
    """Summary of the transfer between different variants, in a sentence or two."""
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
    lines = [f"{metric.title}: {metric.meaning}" for metric in report.metrics.values()]
    lines += interval_notes(found for cell in report.cells for found in cell.estimates.values())
    for name, metric in report.metrics.items():
        paired = [(cell, found) for cell in report.cells if isinstance(found := cell.estimates.get(name), Paired)]
        if without := [
            f"{cell.source} to {cell.target} {found.alone} of {found.pairs}"
            for cell, found in paired
            if found.alone != found.pairs
        ]:
            lines.append(f"{metric.title}, pairs that alone have a value: {', '.join(without)}")
    if any(cell.reaching for cell in report.cells):
        lines.append(f"threshold: success at the end of {report.threshold:g} in a test; (k of n): runs that reached it")
    if over_targets(report):
        lines.append("over arms: each arm counts once, with its mean over the seeds")
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
    columns, axes = report.labels, ("to", "from")
    if len(columns) > MANY:
        rows, columns = (
            [(label, [cells[place] for _, cells in rows]) for place, label in enumerate(columns)],
            [source for source, _ in rows],
        )
        axes = ("from", "to")
        drawing.figure.set_size_inches(WIDTH, HEIGHT * len(rows) / MANY / 2)
    heat_map(drawing, rows, columns, neutral=metric.neutral, larger_is_better=metric.larger_is_better)
    drawing.axes.set(xlabel=axes[0], ylabel=axes[1])
    return drawing


@look()
def pictures(found: Matrix, report: TransferReport) -> list[Drawing]:
    """A picture of each robot with the task, and the success of the sources on it."""
    drawn = []
    for label, spec in found.variants.items():
        if spec.robot is None or label in found.refused:
            continue
        with used(environment_of(spec)) as environment:
            environment.reset(spec.testing.final_seed)
            assert isinstance(environment, RobotTask)
            image = environment.portrait(*PICTURE)
        cells = [one for one in report.cells if one.target == label and "zero_shot" in one.estimates]
        success = ", ".join(f"from {one.source} {tables.estimate(one.estimates['zero_shot'])}" for one in cells)
        drawing = Drawing(f"arm_{file_name(label)}", label, success)
        drawing.axes.imshow(image)
        drawing.axes.set_axis_off()
        drawn.append(drawing)
    return drawn


@look()
def transfer_figures(report: TransferReport) -> tuple[list[Drawing], list[Drawing]]:
    """A heat map for each metric, and the learning curves on each target."""
    curves = [titled_curve(one, f"Learning on {short(label)}") for label, one in report.learning.items()]
    return [metric_map(report, name) for name in report.metrics], curves


def matrix_page(
    report: TransferReport, maps: Sequence[Drawing], curves: Sequence[Drawing], robots: Sequence[Drawing] = ()
) -> str:
    sections = [
        Section(text=verdict(report), figures=maps),
        *(Section(one.title, table=one) for one in over_targets(report)),
        *([Section("Robots", figures=robots)] if robots else []),
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
