"""Tables of runs, tests and specs as plain texts; `karolos_cli.output` and `page` show them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..statistics.intervals import wilson

if TYPE_CHECKING:
    from ..records.results import TestCounts, TestResult
    from ..records.run_records import RunSummary
    from ..records.transfer_results import TransferResult


@dataclass(frozen=True)
class Table:
    """Texts in rows under column headings.

    Args:
        columns: headings; all empty: the table is shown without them.
        rows: as many cells as columns in each.
        title: stands above the table, if it is not empty.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""


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


def rate(per_second: float | None) -> str:
    """A rate without decimals, in groups of three digits; - for None."""
    return "-" if per_second is None else f"{per_second:,.0f}"


def success(ratio: float | None, episodes: int | None) -> str:
    """A success ratio with its Wilson interval at 95 %: 0.97 [0.92, 0.99]; - without a test."""
    if ratio is None or not episodes:
        return "-"
    low, high = wilson(round(ratio * episodes), episodes)
    return f"{ratio:.2f} [{low:.2f}, {high:.2f}]"


def setting(value: object) -> str:
    """A value of a spec as a spec writes it."""
    return value if isinstance(value, str) else json.dumps(value)


def runs_table(runs: Sequence[RunSummary]) -> Table:
    """One row per run. Success is that of the last test; `steps to .95` is when a test first showed that ratio."""
    columns = ["run", "state", "steps", "time", "success any", "end", "steps to .95", "time to .95"]
    tagged = any(run.tags for run in runs)
    rows = [
        (
            run.run,
            run.state,
            count(run.steps),
            duration(run.seconds),
            success(run.success_any, run.episodes),
            "-" if run.success_end is None else f"{run.success_end:.2f}",
            count(run.steps_to_95),
            duration(run.seconds_to_95),
            *([", ".join(run.tags)] if tagged else []),
        )
        for run in runs
    ]
    return Table([*columns, *(["tags"] if tagged else [])], rows)


def table_of_tests(tests: Iterable[TestCounts], results: Iterable[TestResult] = (), *, title: str = "") -> Table:
    """One row per test, with both ways to count success.

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
    columns = ["steps", "time", "success any", "success end", "episodes", "solved at reset"]
    columns += [f"end within {' / '.join(f'{metres:.2f}' for metres in WITHIN)} m"] if near else []
    rows = [
        (
            count(test.steps),
            duration(test.seconds),
            success(test.any / test.episodes, test.episodes),
            success(test.end / test.episodes, test.episodes),
            count(test.episodes),
            count(test.reset),
            *([near.get(test.steps, "-")] if near else []),
        )
        for test in tests
    ]
    return Table(columns, rows, title)


def transfers_table(transfers: Iterable[TransferResult], *, title: str = "") -> Table:
    """One row per test under changed settings, with both ways to count success."""
    columns = ["changed", "checkpoint", "success any", "success end", "episodes", "seed", "when"]
    rows = [
        (
            ", ".join([*transfer.overrides, *(["randomized"] if transfer.randomized else [])]) or "nothing",
            f"{transfer.checkpoint} ({transfer.result.steps:,} steps)",
            success(transfer.result.success_any, transfer.result.episodes),
            success(transfer.result.success_end, transfer.result.episodes),
            count(transfer.result.episodes),
            str(transfer.seed),
            transfer.time[:16].replace("T", " "),
        )
        for transfer in transfers
    ]
    return Table(columns, rows, title)


def facts_table(facts: Mapping[str, object], *, title: str = "") -> Table:
    """Names and their values, one per line; a value None is left out."""
    return Table(("", ""), [(name, str(value)) for name, value in facts.items() if value is not None], title)


def flatten(spec: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """A nested mapping as pairs of key path and value as text: ("agent.learning_rate", "0.001")."""
    from ..records import run_records  # noqa: PLC0415  (yaml, which `karolos --help` can do without)

    for path, value in run_records.flatten(spec):
        yield path, setting(value)
