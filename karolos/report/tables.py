"""Tables for the terminal: runs, tests, specs. Every text that comes from a file is made harmless first."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from ..records import run_records
from ..records.results import WITHIN, TestCounts, TestResult
from ..records.run_records import RunSummary
from ..records.transfer_results import TransferResult
from ..statistics.intervals import wilson
from .terminal import clean

_STATE_STYLES = {
    "finished": "green",
    "running": "cyan",
    "created": "cyan",
    "stopped": "yellow",
    "failed": "red",
    "lost": "red",
}


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


def count(number: int | None) -> str:
    """A whole number in groups of three digits; - for None."""
    return "-" if number is None else f"{number:,}"


def success(share: float | None, episodes: int | None) -> str:
    """A success ratio with its Wilson interval at 95 %: 0.97 [0.92, 0.99]; - without a test."""
    if share is None or not episodes:
        return "-"
    low, high = wilson(round(share * episodes), episodes)
    return f"{share:.2f} [{low:.2f}, {high:.2f}]"


def runs_table(runs: Sequence[RunSummary], *, title: str | None = None) -> Table:
    """One row per run. Success is of the last test, with its 95 % interval; `to .95` is when a test first got there."""
    table = _table("run", "state", title=title)
    for heading in ("steps", "time", "success any", "end", "steps to .95", "time to .95"):
        table.add_column(heading, justify="right")
    tagged = any(run.tags for run in runs)
    if tagged:
        table.add_column("tags", overflow="fold")
    for run in runs:
        table.add_row(
            _plain(run.run),
            _plain(run.state, _STATE_STYLES.get(run.state, "")),
            count(run.steps),
            duration(run.seconds),
            success(run.success_any, run.episodes),
            "-" if run.success_end is None else f"{run.success_end:.2f}",
            count(run.steps_to_95),
            duration(run.seconds_to_95),
            *([_plain(", ".join(run.tags))] if tagged else []),
        )
    return table


def table_of_tests(
    tests: Sequence[TestCounts], results: Sequence[TestResult] = (), *, title: str | None = None
) -> Table:
    """One row per test, both ways to count success with their 95 % intervals.

    Args:
        results: the same tests episode by episode, where their run folder is there: with the distances from the goal.
    """
    table = _table(title=title)
    near = {result.steps: [result.within(metres) for metres in WITHIN] for result in results if result.distances}
    for heading in ("steps", "time", "success any", "success end", "episodes", "solved at reset"):
        table.add_column(heading, justify="right")
    if near:
        table.add_column(f"end within {' / '.join(f'{metres:.2f}' for metres in WITHIN)} m", justify="right")
    for test in tests:
        shares = [" / ".join(f"{share:.2f}" for share in near[test.steps])] if test.steps in near else ["-"]
        table.add_row(
            count(test.steps),
            duration(test.seconds),
            success(test.any / test.episodes, test.episodes),
            success(test.end / test.episodes, test.episodes),
            count(test.episodes),
            count(test.reset),
            *(shares if near else ()),
        )
    return table


def transfers_table(transfers: Sequence[TransferResult], *, title: str | None = None) -> Table:
    """One row per test under changed settings, both ways to count success with their 95 % intervals."""
    table = _table("changed", "checkpoint", title=title)
    for heading in ("success any", "success end", "episodes", "seed", "when"):
        table.add_column(heading, justify="right")
    for transfer in transfers:
        result = transfer.result
        changed = [*transfer.overrides, *(["randomized"] if transfer.randomized else [])]
        table.add_row(
            _plain(", ".join(changed) or "nothing"),
            _plain(f"{transfer.checkpoint} ({result.steps:,} steps)"),
            success(result.success_any, result.episodes),
            success(result.success_end, result.episodes),
            count(result.episodes),
            str(transfer.seed),
            _plain(transfer.time[:16].replace("T", " ")),
        )
    return table


def facts_table(facts: Mapping[str, object], *, title: str | None = None) -> Table:
    """Names and what they stand for, one per line; None is left out."""
    table = Table(box=None, show_header=False, title=title, title_justify="left", pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in facts.items():
        if value is not None:
            table.add_row(_plain(name), _plain(value))
    return table


def flatten(spec: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """A nested mapping as pairs of key path and value as text: ("agent.learning_rate", "0.001")."""
    for path, value in run_records.flatten(spec):
        yield path, setting(value)


def setting(value: object) -> str:
    """A value of a spec as one would write it."""
    return value if isinstance(value, str) else json.dumps(value)


def _table(*columns: str, title: str | None) -> Table:
    table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", pad_edge=False)
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


def _plain(value: object, style: str = "") -> Text:
    """Text that rich takes literally: no markup, no control characters."""
    return Text(clean(value), style)
