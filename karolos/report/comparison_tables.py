"""A comparison as tables, for the terminal and for the page."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from ..comparison import MISSING, Comparison, Estimate, Reaching, Scores
from ..comparison.differences import SideDifference
from ..records.run_records import flatten
from .tables import Columns, Table, count, csv_text, decimals, duration, heading, latex, setting

_INTERVALS = {
    "bootstrap": "[low, high]: 95 % bootstrap interval over 10 seeds or more",
    "approximate": "~[low, high]: 95 % bootstrap interval over 5 to 9 seeds, which covers less than 95 %",
    "range": "(low to high): smallest and largest of 2 to 4 seeds, too few for an interval",
    "wilson": "[low, high] of a single run: 95 % Wilson interval of its test, which says nothing about seeds",
}
"""Kind of an interval -> how it is written and what it is."""


def verdict(comparison: Comparison) -> str:
    """What the comparison says, in a few sentences: the best, and who differs from the first contender."""
    what = {"any": "success at any step", "end": "success at the end", "return": "return"}[comparison.metric]
    found = [{"any": one.any, "end": one.end, "return": one.returns}[comparison.metric] for one in comparison.scores]
    first, *others = comparison.labels
    if not others:
        seeds = len(comparison.contenders[0].runs)
        return f"{first}: {what} {estimate(found[0])} over {seeds} seed{'s' if seeds > 1 else ''}."
    pairs = zip(found, comparison.labels, strict=True)
    known = [(one, label) for one, label in pairs if one is not None and not math.isnan(one.value)]
    groups: dict[str, list[str]] = {"better": [], "worse": [], "alike": [], "few": [], "unknown": []}
    for label, scores in zip(others, comparison.scores[1:], strict=True):
        groups[against_first(scores.improvement)].append(label)
    listed = {key: ", ".join(labels) for key, labels in groups.items() if labels}
    sentences = {
        "better": f"Better than {first}: {{}}.",
        "worse": f"Worse than {first}: {{}}.",
        "alike": f"No difference from {first} is shown: {{}}.",
        "few": f"Too few seeds to tell from {first} (5 of each are needed): {{}}.",
        "unknown": f"Unknown beside {first}, because a return is not finite: {{}}.",
    }
    said = [sentences[key].format(labels) for key, labels in listed.items()]
    if known:
        best, label = max(known, key=lambda one: one[0].value)
        said.insert(0, f"Highest mean of {what}: {label}, {estimate(best)}.")
    return " ".join(said)


def against_first(improvement: Estimate | None) -> str:
    """Key of the group of a contender in the verdict."""
    if improvement is None or math.isnan(improvement.value):
        return "unknown"
    if improvement.kind == "none":
        return "few"
    return "better" if improvement.low > 0.5 else "worse" if improvement.high < 0.5 else "alike"


def scores_table(comparison: Comparison) -> Table:
    """One row per number that a contender has, one column per contender."""
    contenders, metric = comparison.contenders, comparison.metric
    success: Columns[Scores] = {
        "success end": lambda one: estimate(one.end),
        "success any": lambda one: estimate(one.any),
    }
    returns: Columns[Scores] = {"return": lambda one: estimate(one.returns)}
    cells = returns | success if metric == "return" else success | returns
    cells[f"inter-quartile mean, {metric}"] = lambda one: estimate(one.iqm)
    if metric == "return":
        cells["best, return"] = lambda one: estimate(one.best_return)
    else:
        cells["best, end"] = lambda one: estimate(one.best_end)
    cells[f"better than {contenders[0].label}"] = lambda one: estimate(one.improvement, 2)
    for place, reaching in enumerate(comparison.scores[0].reaching):
        for unit, name in (("steps", "steps"), ("seconds", "time")):
            cells[f"{name} to {reaching.ratio * 100:g} %, {metric}"] = partial(_reached, place, unit)
    cells |= {
        "density over seeds": _density,
        "steps of a run": lambda one: count(one.steps),
        "time of a run": lambda one: duration(one.seconds),
        "updates per second": lambda one: count(one.updates_per_second),
    }
    rows = [
        ("experiment", *(contender.experiment[:12] for contender in contenders)),
        ("seeds", *(str(len(contender.runs)) for contender in contenders)),
        *((name, *map(cell, comparison.scores)) for name, cell in cells.items()),
    ]
    return Table(["", *comparison.labels], [row for row in rows if set(row[1:]) != {"-"}])


def measures_table(comparison: Comparison) -> Table:
    """One row per measure, one column per contender."""
    rows = []
    for name, one in comparison.measures.items():
        found = [scores.measures.get(name) for scores in comparison.scores]
        if any(found):
            rows.append((heading(name, one), *(estimate(each, decimals(each.value) if each else 0) for each in found)))
    return Table(["", *comparison.labels], rows, "measures")


def parameters_table(comparison: Comparison) -> Table:
    """The settings that differ, one column per contender."""
    rows = [(path, *map(_value, values)) for path, values in comparison.parameters.items()]
    return Table(["setting", *comparison.labels], rows, "settings that differ")


def comparison_file(comparison: Comparison, suffix: str) -> str:
    """The numbers for a file .csv, one row per contender with the fields of `rows`; or for .tex, as in the tables."""
    if suffix == ".csv":
        return csv_text([dict(flatten(row)) for row in comparison.rows()])
    scores = scores_table(comparison)
    experiments = [f"{one.label}: experiment {one.experiment}" for one in comparison.contenders]
    notes = ["needs \\usepackage{booktabs}", *experiments, *explanations(comparison)]
    return latex([replace(scores, rows=scores.rows[1:]), measures_table(comparison)], notes)


def differences_table(differences: Sequence[SideDifference], a: str, b: str) -> Table:
    """What differs in what two runs were made from."""
    return Table(["", a, b], [(f"{one.part}: {one.key}", _value(one.a), _value(one.b)) for one in differences])


def explanations(comparison: Comparison) -> list[str]:
    """What the signs in the scores mean, as far as they occur."""
    scores = comparison.scores
    final = [run.summary.final for contender in comparison.contenders for run in contender.runs]
    what = "success and return are those" if any(one.end for one in scores) else "the return is that"
    lines = [f"{what} of {_reported_test(final)}; the unit is the seed"]
    if comparison.at is not None:
        lines.append(f"the runs are compared as they were at their tests nearest to {comparison.at:,} steps")
    if any(one.best_end or one.best_return for one in scores):
        lines.append("best: the policy of the best test, in the final test, whose episodes it was not chosen on")
    if comparison.measures:
        lines.append(
            "measures: mean over the episodes of that test in which it is defined; the smaller the better, if nothing "
            "else is said; - if no episode of some run defines it"
        )
    lines += interval_notes(found for one in scores for found in (one.any, one.returns))
    if comparison.metric == "return":
        lines.append("steps and time to a threshold and densities over seeds exist for success only")
    else:
        lines.append(
            f"steps and time to: median over seeds of the first test with that success ({comparison.metric}); "
            "(k of n) reached it; - if half of the seeds or more did not"
        )
    if len(scores) > 1:
        lines.append("better than: probability that a run is better than one of the first contender; .5: no difference")
    if any(one.density for one in scores):
        lines.append("density over seeds: its modes, and the range of 5 to 95 % of its mass")
    return lines


def _reported_test(final: Sequence[bool]) -> str:
    if all(final):
        return "the last policy in the final test, on episodes that nothing was chosen on"
    return "the final test, or of the last test where a run has no final test" if any(final) else "the last test"


def interval_notes(found: Iterable[Estimate | None]) -> list[str]:
    """What the brackets of some estimates mean."""
    kinds = {one.kind for one in found if one is not None}
    return [text for kind, text in _INTERVALS.items() if kind in kinds]


def estimate(found: Estimate | None, digits: int = 3) -> str:
    """A number with its interval, whose brackets tell its kind; - for None."""
    if found is None:
        return "-"
    value, low, high = (decimal(number, digits) for number in (found.value, found.low, found.high))
    if found.kind == "none":
        return value
    if found.kind == "range":
        return f"{value} ({low} to {high})"
    return f"{value} {'~' if found.kind == 'approximate' else ''}[{low}, {high}]"


def decimal(number: float, digits: int = 3) -> str:
    """A number with so many decimals; \N{INFINITY} for inf."""
    return "\N{INFINITY}" if number == math.inf else f"{number:.{digits}f}"


def reached(found: Reaching | None, unit: str = "steps") -> str:
    """Median steps or seconds to a threshold, and how many runs reached it; - for None."""
    if found is None:
        return "-"
    median = count(found.steps) if unit == "steps" else duration(found.seconds)
    return f"{median} ({found.reached} of {found.seeds})"


def _value(value: Any) -> str:
    """A value of a spec as a spec writes it; - where the spec has no such key."""
    return "-" if value is MISSING else setting(value)


def _reached(place: int, unit: str, scores: Scores) -> str:
    return reached(scores.reaching[place], unit)


def _density(scores: Scores) -> str:
    found = scores.density
    if found is None:
        return "-"
    return f"{' and '.join(f'{mode:.2f}' for mode in found.modes)}; {found.low:.2f} - {found.high:.2f}"
