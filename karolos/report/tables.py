"""Tables of runs, tests and specs as plain texts; `karolos_cli.output` and `page` show them."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean, median
from typing import TYPE_CHECKING, Any, TypeVar

from ..statistics.intervals import wilson

if TYPE_CHECKING:
    from ..records.results import FinalTest, MeasureMean, MeasureValues, TestCounts, TestResult
    from ..records.run_records import RunSummary
    from ..records.transfer_results import TransferResult

T = TypeVar("T")
Columns = dict[str, Callable[[T], str]]
"""Heading of a column -> its cell for an object."""


@dataclass(frozen=True)
class Table:
    """Texts in rows under column headings.

    Args:
        columns: headings; all empty: the table is shown without them.
        rows: as many cells as columns in each.
        title: stands above the table, if it is not empty.
        optional: columns that a narrow terminal leaves out, the first of them first.
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
        """A table with one row for each of some objects, without columns that have a value in no row."""
        cells = {name: [cell(row) for row in rows] for name, cell in columns.items()}
        known = {name: texts for name, texts in cells.items() if not {"", "-"}.issuperset(texts)}
        return cls(list(known), list(zip(*known.values(), strict=True)), title)


def clean(text: object, allowed: str = "") -> str:
    """A text without characters that steer a terminal or reorder a line; "\N{REPLACEMENT CHARACTER}" replaces each.

    Args:
        text: often comes from a file.
        allowed: characters to let through although they are not printable, such as a line break.
    """
    return "".join(
        character if character.isprintable() or character in allowed else "\N{REPLACEMENT CHARACTER}"
        for character in str(text)
    )


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as comma-separated values under the names of all of them; a list is one cell.

    A text that a spreadsheet would take for a formula gets an apostrophe in front (OWASP, CSV injection).
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
    """Seconds as a person reads them: 47.2 s, 12 min 03 s, 1 h 05 min; - for None."""
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
    """Decimals that show three significant digits of a number, or more where it is large."""
    return max(0, 2 - math.floor(math.log10(abs(value)))) if value else 0


def heading(name: str, measure: MeasureMean | MeasureValues) -> str:
    """A measure with its unit, and with its direction where the larger is better."""
    unit = "" if measure["unit"] == "1" else f", {measure['unit']}"
    return f"{name}{unit}{', larger is better' if measure['better'] == 'larger' else ''}"


def setting(value: object) -> str:
    """A value of a spec as a spec writes it."""
    return value if isinstance(value, str) else json.dumps(value)


def runs_table(runs: Sequence[RunSummary]) -> Table:
    """One row per run. Success and return are those of the final test, or of the last test before it.

    `best` is the policy `best` in the final test, `best end` its success at the end. `time` is that of collecting and
    learning, `total` that from start to end. `steps to .95 end` is when a test first showed that ratio at the end of
    its episodes. Where no run has success, the return stands in the place of these columns.
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
    """The state, the speed of a run that trains, and whether one that has ended made no gradient update."""
    if run.state == "running" and run.seconds:
        return f"running, {run.steps / run.seconds:,.0f} steps/s"
    return f"{run.state}, no update" if run.updates == 0 and run.state in ("finished", "stopped") else run.state


def table_of_tests(tests: Iterable[TestCounts], results: Iterable[TestResult] = (), *, title: str = "") -> Table:
    """One row per test, with both ways to count success, or without success where no test has it.

    Args:
        tests: what to show.
        results: the same tests episode by episode, as far as the run folder has them. They add how many episodes end
            within some distances of the goal.
        title: of the table.
    """
    from ..records.results import WITHIN  # noqa: PLC0415  (numpy)

    near = {
        result.steps: " / ".join(f"{result.within(metres):.2f}" for metres in WITHIN)
        for result in results
        if result.distances
    }
    columns: Columns[TestCounts] = {
        "steps": lambda test: count(test.steps),
        "time": lambda test: duration(test.seconds),
        "success end": lambda test: success(test.success_end, test.episodes),
        "success any": lambda test: success(test.success_any, test.episodes),
        "return": lambda test: number(test.mean_return),
        "episodes": lambda test: count(test.episodes),
        "solved at reset": lambda test: count(test.solved_at_reset),
        f"end within {' / '.join(f'{metres:.2f}' for metres in WITHIN)} m": lambda test: near.get(test.steps, "-"),
    }
    return Table.of(list(tests), columns, title)


def table_of_final(final: FinalTest, *, title: str = "") -> Table:
    """One row per policy of a final test, with the columns of `table_of_tests`."""
    from ..records.results import TestCounts  # noqa: PLC0415  (numpy)

    policies = {"last": final.last, "best": final.best}
    tested = {name: result for name, result in policies.items() if result is not None}
    table = table_of_tests(map(TestCounts.of, tested.values()), tested.values())
    rows = [(name, *row) for name, row in zip(tested, table.rows, strict=True)]
    return Table(["policy", *table.columns], rows, title)


def measures_table(measures: Mapping[str, MeasureValues], title: str) -> Table:
    """One row per measure of a test: over the episodes in which it is defined."""

    def row(name: str, one: MeasureValues) -> tuple[str, ...]:
        known = [value for value in one["values"] if value is not None]
        worst = max if one["better"] == "smaller" else min
        found = (
            (f"{each:.{decimals(each)}f}" for each in (fmean(known), median(known), worst(known))) if known else "---"
        )
        return (heading(name, one), *found, f"{len(known)} of {len(one['values'])}")

    rows = [row(name, one) for name, one in measures.items()]
    return Table(["measure", "mean", "median", "worst", "episodes"], rows, title)


def transfers_table(transfers: Iterable[TransferResult], *, title: str = "") -> Table:
    """One row per test under changed settings. Unchanged: this policy and these episodes in its own environment."""
    from ..records.results import TestCounts  # noqa: PLC0415  (numpy)

    columns: Columns[TransferResult] = {
        "changed": lambda one: ", ".join([*one.overrides, *(["randomized"] * one.randomized)]) or "nothing",
        "checkpoint": lambda one: f"{one.checkpoint} ({one.result.steps:,} steps)",
        "success end": lambda one: success(TestCounts.of(one.result).success_end, one.result.episodes),
        "success any": lambda one: success(TestCounts.of(one.result).success_any, one.result.episodes),
        "unchanged end": lambda one: success(one.own.success_end, one.own.episodes),
        "unchanged any": lambda one: number(one.own.success_any),
        "return": lambda one: number(one.result.mean_return),
        "unchanged return": lambda one: number(one.own.mean_return),
        "episodes": lambda one: count(one.result.episodes),
        "seed": lambda one: str(one.seed),
        "when": lambda one: one.time[:16].replace("T", " "),
    }
    return Table.of(list(transfers), columns, title)


def facts_table(facts: Mapping[str, object], *, title: str = "") -> Table:
    """Names and their values, one per line; a value None is left out."""
    return Table(("", ""), [(name, str(value)) for name, value in facts.items() if value is not None], title)


def settings_table(spec: Mapping[str, Any], title: str) -> Table:
    """A spec as key paths and values: agent.learning_rate 0.001."""
    from ..records import run_records  # noqa: PLC0415  (yaml, which `karolos --help` can do without)

    return facts_table({path: setting(value) for path, value in run_records.flatten(spec)}, title=title)
