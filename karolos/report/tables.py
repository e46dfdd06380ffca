"""Tables of runs, tests, specs and comparisons as plain texts; `karolos_cli.output` and `page` show them."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import fmean, median
from typing import TYPE_CHECKING, Any, TypeVar

from ..records.intervals import wilson

if TYPE_CHECKING:
    from ..comparison.scores import Comparison, Estimate, Reaching, Scores
    from ..records.evaluation import Evaluation, Measured
    from ..records.run_records import RunSummary

_INTERVALS = {
    "bootstrap": "[low, high]: 95 % bootstrap interval over 10 seeds or more",
    "approximate": "~[low, high]: 95 % bootstrap interval over 5 to 9 seeds, which covers less than 95 %",
    "range": "(low to high): smallest and largest of 2 to 4 seeds, too few for an interval",
    "wilson": "[low, high] of a single run: 95 % Wilson interval of its test, which says nothing about seeds",
}
"""Kind of an interval -> its brackets and explanation."""
T = TypeVar("T")
Columns = dict[str, Callable[[T], str]]
"""Heading of a column -> its cell for an object."""


@dataclass(frozen=True)
class Table:
    """Texts in rows under column headings. If all of these are empty, the table is shown without them.

    A narrow terminal leaves out the `optional` columns, in this order.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    optional: tuple[str, ...] = ()

    def without(self, name: str) -> Table:
        """The table without a column."""
        place = list(self.columns).index(name)
        rows = [[*row[:place], *row[place + 1 :]] for row in self.rows]
        columns = [*self.columns[:place], *self.columns[place + 1 :]]
        return replace(self, columns=columns, rows=rows, optional=tuple(one for one in self.optional if one != name))

    @classmethod
    def of(cls, rows: Sequence[T], columns: Columns[T], title: str = "") -> Table:
        """A table with one row per object, without empty columns."""
        cells = {name: [cell(row) for row in rows] for name, cell in columns.items()}
        known = {name: texts for name, texts in cells.items() if not {"", "-"}.issuperset(texts)}
        return cls(list(known), list(zip(*known.values(), strict=True)), title)


def clean(text: object, allowed: str = "") -> str:
    """A text without characters that control a terminal or reorder a line; "\N{REPLACEMENT CHARACTER}" replaces each.

    `allowed` characters stay although they are not printable, such as a line break.
    """
    return "".join(
        character if character.isprintable() or character in allowed else "\N{REPLACEMENT CHARACTER}"
        for character in str(text)
    )


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as comma-separated values under the names of all of them; a list is one cell.

    A text that looks like a formula to a spreadsheet gets an apostrophe in front (OWASP, CSV injection).
    """
    text, names = io.StringIO(), list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([[_csv_cell(row.get(name)) for name in names] for row in ({one: one for one in names}, *rows)])
    return text.getvalue() if names else ""


def _csv_cell(value: Any) -> object:
    if isinstance(value, list | tuple):
        value = "; ".join(map(str, value))
    if isinstance(value, Mapping):
        return json.dumps(finite(value))
    if not isinstance(value, str):
        return value
    text = clean(value, allowed="\n")
    numbers = re.fullmatch(r"-?[\d.e+-]+(; -?[\d.e+-]+)*", text)
    return f"'{text}" if text.lstrip().startswith(("=", "+", "-", "@")) and not numbers else text


def finite(value: Any) -> Any:
    """The value with null for numbers that JSON lacks: nan and the infinities."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite(entry) for entry in value]
    return value


_NAMED = {"\\": "backslash", "~": "asciitilde", "^": "asciicircum", "<": "less", ">": "greater", "|": "bar"}
_LATEX = {sign: f"\\text{name}{{}}" for sign, name in _NAMED.items()} | {sign: f"\\{sign}" for sign in "&%$#_{}"}
_LATEX |= {"\N{INFINITY}": "$\\infty$", "\N{REPLACEMENT CHARACTER}": "?"}


def latex(tables: Iterable[Table], notes: Iterable[str] = ()) -> str:
    """Tables of the same columns below each other, in LaTeX with the package booktabs; notes as comments above."""
    blocks = [(table.columns, [_latex_row(row) for row in table.rows]) for table in tables if table.rows]
    columns = blocks[0][0]
    lines = [*(f"% {clean(note)}" for note in notes), f"\\begin{{tabular}}{{{'l' * len(columns)}}}", "\\toprule"]
    lines += [_latex_row(columns), *(line for _, rows in blocks for line in ("\\midrule", *rows))]
    return "\n".join([*lines, "\\bottomrule", "\\end{tabular}", ""])


def _latex_row(cells: Iterable[str]) -> str:
    texts = ["".join(_LATEX.get(sign, sign) for sign in clean(cell)) for cell in cells]
    signed = [re.sub(r"(?<!\w)-(?=[\d.])", "$-$", re.sub(r"(?<!\S)-(?!\S)", "--", text)) for text in texts]
    return f"{{}}{' & '.join(signed)} \\\\"  # without {} a * or [ would belong to the \\\\ before it


def duration(seconds: float | None) -> str:
    """Seconds for a person: 47.2 s, 12 min 03 s, 1 h 05 min; - for None."""
    if seconds is None:
        return "-"
    if seconds < 99.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02} min"


def count(value: float | None) -> str:
    """A number without decimals, in groups of three digits; - for None."""
    return "-" if value is None else f"{value:,.0f}"


def counted(number: int, noun: str) -> str:
    """A number and its noun: 1 run, 2 runs."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def success(ratio: float | None, episodes: int | None) -> str:
    """A success ratio with its Wilson interval at 95 %: 0.97 [0.92, 0.99]; - without a test."""
    if ratio is None or not episodes:
        return "-"
    low, high = wilson(round(ratio * episodes), episodes)
    return f"{ratio:.2f} [{low:.2f}, {high:.2f}]"


def number(value: float | None) -> str:
    """A number with two decimals, in groups of three digits; - for None."""
    return "-" if value is None else f"{value:,.2f}"


def decimals(value: float) -> int:
    """Number of decimals for three significant digits of a number, or more if it is large."""
    return max(0, 2 - math.floor(math.log10(abs(value)))) if value else 0


def heading(name: str, measure: Measured) -> str:
    """A measure with its unit, and with its direction if larger is better."""
    unit = "" if measure["unit"] == "1" else f", {measure['unit']}"
    return f"{name}{unit}{', larger is better' if measure['better'] == 'larger' else ''}"


def setting(value: object) -> str:
    """A value of a spec as a spec writes it."""
    return value if isinstance(value, str) else json.dumps(value)


def runs_table(runs: Sequence[RunSummary]) -> Table:
    """One row per run. Success and return are those of the final test, or of the last test before it.

    `best` is the policy `best` in the final test, `best end` its success at the end. `time` is that of collecting and
    learning, `total` that from start to end. `steps to .95 end` is when a test first showed that ratio at the end of
    its episodes. If no run has success, the return replaces these columns.
    """
    columns: Columns[RunSummary] = {
        "run": lambda run: run.run,
        "state": run_state,
        "steps": lambda run: count(run.steps),
        "time": lambda run: duration(run.seconds),
        "total": lambda run: duration(run.total_seconds),
        "success end": lambda run: success(run.success_end, run.episodes),
        "any": lambda run: number(run.success_any),
        "best end": lambda run: number(run.best_end),
        "steps to .95 end": lambda run: count(run.steps_to_95),
        "time to .95 end": lambda run: duration(run.seconds_to_95),
        "return": lambda run: number(run.mean_return),
        "best return": lambda run: number(run.best_return),
        "tags": lambda run: ", ".join(run.tags),
    }
    optional = ["time to .95 end", "any", "best end", "total"]
    if any(run.success_end is not None for run in runs):
        del columns["best return"]
        optional.append("return")
    table = Table.of(runs, columns)
    return replace(table, optional=tuple(name for name in optional if name in table.columns))


def run_state(run: RunSummary) -> str:
    """The state, the speed of a training run, and a note if an ended run made no gradient update."""
    if run.state == "running" and run.seconds:
        return f"running, {run.steps / run.seconds:,.0f} steps/s"
    return f"{run.state}, no update" if run.updates == 0 and run.state in ("finished", "stopped") else run.state


def run_facts(
    run: RunSummary, about: Mapping[str, Any], checkpoints: Sequence[Mapping[str, Any]] | None = None
) -> dict[str, object]:
    """Facts about a run other than its tests and settings; None for unknown ones.

    `about` is the content of its run.json or empty, `checkpoints` their names and meta; None leaves them out.
    """
    git = about.get("git") or {}
    points = [f"{point['name']} ({point.get('steps', 0):,} steps)" for point in checkpoints or ()]
    return {
        "run": run.run,
        "state": run_state(run) if run.error is None else f"{run.state}: {run.error}",
        "experiment": run.experiment,
        "steps": f"{run.steps:,}, {duration(run.seconds)} of collecting and learning",
        "total": duration(run.total_seconds),
        "to .95, end": run.steps_to_95 and f"{run.steps_to_95:,} steps, {duration(run.seconds_to_95)}",
        **{name: f"{getattr(run, name)[:19].replace('T', ' ')} UTC" for name in ("created", "updated")},
        "folder": run.folder,
        "tags": ", ".join(run.tags) or None,
        "note": run.note,
        "checkpoints": None if checkpoints is None else ", ".join(points) or "none",
        "command": shlex.join(about.get("command") or ()) or None,
        "git commit": (git and f"{git.get('commit', '')[:12]}{' with changes (code.diff)' if git.get('dirty') else ''}")
        or None,
        "versions": ", ".join(f"{name} {version}" for name, version in (about.get("versions") or {}).items()) or None,
    }


def evaluations_table(tests: Iterable[Evaluation], *, title: str = "") -> Table:
    """One row per test, with both kinds of success, or without success if no test has it.

    If the episodes are known, it shows how many ended within some distances of the goal.
    """
    from ..records.evaluation import WITHIN  # noqa: PLC0415  (pydantic)

    def near(test: Evaluation) -> str:
        return " / ".join(f"{test.within(metres):.2f}" for metres in WITHIN) if test.distances else "-"

    columns: Columns[Evaluation] = {
        "policy": lambda test: test.checkpoint or "",
        "steps": lambda test: count(test.steps),
        "time": lambda test: duration(test.seconds),
        "success end": lambda test: success(test.success_end, test.episodes),
        "success any": lambda test: success(test.success_any, test.episodes),
        "return": lambda test: number(test.mean_return),
        "episodes": lambda test: count(test.episodes),
        "solved at reset": lambda test: count(test.solved_at_reset),
        f"end within {' / '.join(f'{metres:.2f}' for metres in WITHIN)} m": near,
    }
    return Table.of(list(tests), columns, title)


def measures_table(measures: Mapping[str, Measured], title: str = "") -> Table:
    """One row per measure of a test, over the episodes in which it is defined."""

    def row(name: str, one: Measured) -> tuple[str, ...]:
        values = one.get("values", ())
        known = [value for value in values if value is not None]
        worst = max if one["better"] == "smaller" else min
        found = [fmean(known), median(known), worst(known)] if known else []
        shown = (f"{each:.{decimals(each)}f}" for each in found) if found else "---"
        return (heading(name, one), *shown, f"{len(known)} of {len(values)}")

    rows = [row(name, one) for name, one in measures.items()]
    return Table(["measure", "mean", "median", "worst", "episodes"], rows, title)


def transfers_table(transfers: Iterable[Evaluation], *, title: str = "") -> Table:
    """One row per test under changed settings. "Unchanged": the same policy and episodes without the changes."""

    def own(cell: Callable[[Evaluation], str]) -> Callable[[Evaluation], str]:
        return lambda one: cell(one.own) if one.own else "-"

    columns: Columns[Evaluation] = {
        "changed": lambda one: ", ".join([*one.overrides, *(["randomized"] * one.randomized)]) or "nothing",
        "checkpoint": lambda one: f"{one.checkpoint} ({one.steps:,} steps)",
        "success end": lambda one: success(one.success_end, one.episodes),
        "success any": lambda one: success(one.success_any, one.episodes),
        "unchanged end": own(lambda one: success(one.success_end, one.episodes)),
        "unchanged any": own(lambda one: number(one.success_any)),
        "return": lambda one: number(one.mean_return),
        "unchanged return": own(lambda one: number(one.mean_return)),
        "episodes": lambda one: count(one.episodes),
        "seed": lambda one: str(one.seed),
        "when": lambda one: str(one.time)[:16].replace("T", " "),
    }
    return Table.of(list(transfers), columns, title)


def stages_table(stages: Mapping[str, tuple[int, int]], *, title: str = "") -> Table:
    """One row per stage in which training episodes began, from `RunFolder.stages`."""
    rows = [(stage, count(played), success(ended / played, played)) for stage, (played, ended) in stages.items()]
    return Table(["began", "episodes", "success end"], rows, title)


def facts_table(facts: Mapping[str, object], *, title: str = "") -> Table:
    """Names and their values, one per line; a value None is left out."""
    return Table(("", ""), [(name, str(value)) for name, value in facts.items() if value is not None], title)


def settings_table(spec: Mapping[str, Any], title: str) -> Table:
    """A spec as key paths and values: agent.learning_rate 0.001."""
    from ..records import run_records  # noqa: PLC0415  (yaml, which `karolos --help` can do without)

    return facts_table({path: setting(value) for path, value in run_records.flatten(spec)}, title=title)


def verdict(comparison: Comparison) -> str:
    """Summary of the comparison, in a few sentences: the best contender, and differences from the first one."""
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
        "unknown": f"Not comparable with {first}, because a return is not finite: {{}}.",
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

    def density(one: Scores) -> str:
        if one.density is None:
            return "-"
        modes = " and ".join(f"{mode:.2f}" for mode in one.density.modes)
        return f"{modes}; {one.density.low:.2f} - {one.density.high:.2f}"

    def reaching(place: int, unit: str, one: Scores) -> str:
        return reached(one.reaching[place], unit)

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
    for place, threshold in enumerate(comparison.scores[0].reaching):
        for unit, name in (("steps", "steps"), ("seconds", "time")):
            cells[f"{name} to {threshold.ratio * 100:g} %, {metric}"] = partial(reaching, place, unit)
    cells |= {
        "density over seeds": density,
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


def compared_measures_table(comparison: Comparison) -> Table:
    """One row per measure, one column per contender."""
    rows = []
    for name, one in comparison.measures.items():
        found = [scores.measures.get(name) for scores in comparison.scores]
        if any(found):
            rows.append((heading(name, one), *(estimate(each, decimals(each.value) if each else 0) for each in found)))
    return Table(["", *comparison.labels], rows, "measures")


def parameters_table(comparison: Comparison) -> Table:
    """The settings that differ, one column per contender."""
    from ..comparison.differences import MISSING  # noqa: PLC0415  (yaml, which `karolos --help` can do without)

    rows = [
        (path, *("-" if value is MISSING else setting(value) for value in values))
        for path, values in comparison.parameters.items()
    ]
    return Table(["setting", *comparison.labels], rows, "settings that differ")


def comparison_file(comparison: Comparison, suffix: str) -> str:
    """The numbers for a file .csv, one row per contender with the fields of `rows`; or for .tex, as in the tables."""
    from ..records.run_records import flatten  # noqa: PLC0415  (pydantic)

    if suffix == ".csv":
        return csv_text([dict(flatten(row)) for row in comparison.rows()])
    scores = scores_table(comparison)
    experiments = [f"{one.label}: experiment {one.experiment}" for one in comparison.contenders]
    notes = ["needs \\usepackage{booktabs}", *experiments, *explanations(comparison)]
    return latex([replace(scores, rows=scores.rows[1:]), compared_measures_table(comparison)], notes)


def differences_table(rows: Sequence[Mapping[str, Any]], a: str, b: str) -> Table:
    """Differences between the sources of two runs: the rows of `compare_sides`."""
    sides = [["-" if one["missing"] == side else setting(one[side]) for side in "ab"] for one in rows]
    return Table(["", a, b], [(f"{one['part']}: {one['key']}", *each) for one, each in zip(rows, sides, strict=True)])


def explanations(comparison: Comparison) -> list[str]:
    """Meaning of the signs that occur in the scores."""
    scores = comparison.scores
    final = [run.summary.final for contender in comparison.contenders for run in contender.runs]
    what = "success and return are those" if any(one.end for one in scores) else "the return is that"
    lines = [f"{what} of {_reported_test(final)}; the unit is the seed"]
    if comparison.at is not None:
        lines.append(f"the runs are compared as they were at their tests nearest to {comparison.at:,} steps")
    if any(one.best_end or one.best_return for one in scores):
        lines.append("best: the policy of the best test, in the final test, in held-out episodes")
    if comparison.measures:
        lines.append(
            "measures: mean over the episodes of that test in which the measure is defined; smaller is better, unless "
            "the heading says otherwise; -: undefined in all episodes of a run"
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
        return "the last policy in the final test, in held-out episodes"
    return "the final test, or of the last test where a run has no final test" if any(final) else "the last test"


def interval_notes(found: Iterable[Estimate | None]) -> list[str]:
    """Meaning of the brackets of these estimates."""
    kinds = {one.kind for one in found if one is not None}
    return [text for kind, text in _INTERVALS.items() if kind in kinds]


def estimate(found: Estimate | None, digits: int = 3) -> str:
    """A number with its interval, whose brackets show its kind; - for None."""
    if found is None:
        return "-"
    value, low, high = (decimal(number, digits) for number in (found.value, found.low, found.high))
    if found.kind == "none":
        return value
    if found.kind == "range":
        return f"{value} ({low} to {high})"
    return f"{value} {'~' if found.kind == 'approximate' else ''}[{low}, {high}]"


def decimal(number: float, digits: int = 3) -> str:
    """A number with this many decimals; \N{INFINITY} for inf."""
    return "\N{INFINITY}" if number == math.inf else f"{number:.{digits}f}"


def reached(found: Reaching | None, unit: str = "steps") -> str:
    """Median steps or seconds to a threshold, and the number of runs that reached it; - for None."""
    if found is None:
        return "-"
    median = count(found.steps) if unit == "steps" else duration(found.seconds)
    return f"{median} ({found.reached} of {found.seeds})"
