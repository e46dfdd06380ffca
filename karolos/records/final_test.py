"""The final test of a run: the policies of `last` and `best` on episodes that nothing was chosen on.

It is stored in final.jsonl of the run's folder, which is written whole: one line that describes the test, and one line
per policy in the format of tests.jsonl.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from ..files import parse_object, write_whole
from .results import TestCounts, TestResult, count_test, decode_test, encode_test

FILE = "final.jsonl"
Test = TypeVar("Test", TestResult, TestCounts)


@dataclass(frozen=True)
class FinalTest(Generic[Test]):
    """The final test, episode by episode (TestResult) or as counts (TestCounts)."""

    seed: int
    """Root of the test episodes' seeds."""
    last: Test
    best: Test | None
    """None if the checkpoint `best` could not be written or read."""
    last_sha256: str
    """Of the agent's state in the checkpoint `last`; it identifies the policy."""
    best_sha256: str | None


def write(folder: Path, final: FinalTest[TestResult]) -> None:
    """Write the final test of the run in this folder, whole or not at all.

    Raises:
        MachineError: the folder cannot be written.
    """
    description = {"seed": final.seed, "last": final.last_sha256, "best": final.best_sha256}
    rows = [description, *(encode_test(result) for result in (final.last, final.best) if result is not None)]
    write_whole(folder / FILE, "".join(json.dumps(row, separators=(",", ":"), allow_nan=False) + "\n" for row in rows))


def read(folder: Path) -> FinalTest[TestResult] | None:
    """The final test of the run in this folder; None if there is none, or its file is damaged (`is_damaged`)."""
    return _read(folder, _result)


def read_counts(folder: Path) -> FinalTest[TestCounts] | None:
    """As `read`, but the counts, which takes less time."""
    return _read(folder, _counts)


def is_damaged(folder: Path) -> bool:
    """Whether the folder has a final test that cannot be read."""
    return (folder / FILE).exists() and read_counts(folder) is None


def _read(folder: Path, decode: Callable[[bytes], Test | None]) -> FinalTest[Test] | None:
    try:
        head, *lines, end = (folder / FILE).read_bytes().split(b"\n")
    except (OSError, ValueError):  # missing, or a single line
        return None
    row = parse_object(head)
    tests = [decode(line) for line in lines]
    if row is None or end or type(row.get("seed")) is not int or not tests or None in tests:
        return None
    last, best = row.get("last"), row.get("best")
    if not isinstance(last, str) or not isinstance(best, str | None) or len(tests) != (1 if best is None else 2):
        return None
    assert tests[0] is not None  # see above
    return FinalTest(row["seed"], tests[0], None if best is None else tests[1], last, best)


def _result(line: bytes) -> TestResult | None:
    row = parse_object(line)
    return None if row is None else decode_test(row)


def _counts(line: bytes) -> TestCounts | None:
    counts = count_test(line)
    if counts is None and (result := _result(line)) is not None:
        counts = TestCounts.of(result)
    return counts
