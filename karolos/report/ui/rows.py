"""The rows of the list of experiments: seeds, success with its interval, curve and cost, only from the index."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean

from ...comparison.contenders import averaged, name_of, one_per_seed
from ...comparison.scores import Estimate, estimate_alone
from ...records.run_records import RunSummary
from ...store import Store
from ...store.experiments import CurvePoint, curves, steps_asked
from .. import tables
from ..tables import count, duration

WIDTH, HEIGHT, EDGE = 120.0, 30.0, 2.0
"""Size of a sparkline, and the margin around its lines, in pixels."""
MOST_LINES = 12
"""Largest number of seeds in a sparkline; more cannot be distinguished."""
SIGNS = {"finished": "✓", "running": "▶", "created": "…", "stopped": "‖", "failed": "✕", "lost": "?"}
"""State -> a sign, so that states can be distinguished without colours."""


@dataclass(frozen=True)
class Seed:
    """A run of an experiment, as a link."""

    run: RunSummary
    sign: str
    text: str
    """State, progress and success."""


@dataclass(frozen=True)
class ExperimentRow:
    """An experiment in the list."""

    experiment: str
    name: str
    about: str
    """Task, robot and agent."""
    seeds: tuple[Seed, ...]
    result: Estimate | None
    """Success at the end, or return; None before the first test."""
    is_ratio: bool
    """Whether it is success."""
    value: str
    interval: str
    lines: tuple[str, ...]
    """A curve over training for each seed, as points of an SVG polyline."""
    steps: str
    """Mean steps over the runs; for training runs with the requested steps."""
    seconds: str
    updated: str
    """Time in UTC."""


def experiment_rows(store: Store, experiments: Iterable[Sequence[RunSummary]]) -> list[ExperimentRow]:
    """The rows of some experiments, each given by its runs."""
    found = [tuple(reversed(runs)) for runs in experiments]
    drawn = {run.run for runs in found for run in list(one_per_seed(runs).values())[:MOST_LINES]}
    tests = curves(store, sorted(drawn))
    asked = steps_asked(store, [run.run for runs in found for run in runs if run.state == "running"])
    return [_row(runs, tests, asked) for runs in found]


def _row(runs: Sequence[RunSummary], tests: dict[str, list[CurvePoint]], asked: dict[str, int]) -> ExperimentRow:
    counted, left_out = averaged(runs)
    has_success = any(run.success_end is not None for run in counted)
    reported = [run.success_end if has_success else run.mean_return for run in counted]
    episodes = next((run.episodes for run in counted if run.episodes), None)
    result = estimate_alone(tuple(one for one in reported if one is not None), episodes if has_success else None)
    value, _, interval = tables.estimate(result).partition(" ")
    steps = count(fmean(run.steps for run in counted))
    if training := [run for run in runs if run.run in asked]:
        steps = f"{count(fmean(run.steps for run in training))} of {count(max(asked[run.run] for run in training))}"
    first = runs[-1]
    return ExperimentRow(
        experiment=first.experiment,
        name=name_of(runs[::-1]),
        about=", ".join(filter(None, (first.task or first.environment, first.robot, first.agent))),
        seeds=tuple(_seed(run, asked) for run in sorted(runs, key=lambda run: (run.seed, run.created))),
        result=result,
        is_ratio=has_success,
        value=value,
        interval=", ".join(filter(None, (interval, left_out))),
        lines=sparkline([_curve(tests[run.run], has_success) for run in runs if run.run in tests], has_success),
        steps=steps,
        seconds=duration(fmean(run.seconds for run in counted)),
        updated=max(run.updated for run in runs)[:16].replace("T", " "),
    )


def _seed(run: RunSummary, asked: dict[str, int]) -> Seed:
    progress = f" {count(run.steps)} of {count(asked[run.run])} steps" if run.run in asked else ""
    success = "" if run.success_end is None else f", success {run.success_end:.3f}"
    why = f": {run.error}" if run.error else ""
    return Seed(run, SIGNS.get(run.state, "?"), f"seed {run.seed}, {run.state}{progress}{success}{why}")


def _curve(tests: Sequence[CurvePoint], has_success: bool) -> list[tuple[float, float]]:
    points = [(test.steps, test.success_end if has_success else test.mean_return) for test in tests]
    return [(steps, value) for steps, value in points if value is not None]


def sparkline(curves: Sequence[Sequence[tuple[float, float]]], is_ratio: bool) -> tuple[str, ...]:
    """Curves as points of SVG polylines in one frame, from 0 to 1 or from the smallest to the largest value."""
    points = [point for curve in curves for point in curve]
    if not points:
        return ()
    right = max(x for x, _ in points) or 1.0
    low, high = (0.0, 1.0) if is_ratio else (min(y for _, y in points), max(y for _, y in points))
    across, up = (WIDTH - 2 * EDGE) / right, (HEIGHT - 2 * EDGE) / ((high - low) or 1.0)
    return tuple(
        " ".join(
            f"{EDGE + x * across:.1f},{HEIGHT - EDGE - (y - low) * up:.1f}" for x, y in curve * (1 + (len(curve) == 1))
        )
        for curve in map(list, curves)  # a single point is drawn as a line to itself
    )
