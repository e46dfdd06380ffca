"""The final test of a run: the policies of `last` and `best` on episodes that nothing was chosen on.

It is stored in final.jsonl of the run's folder, which is written whole: one line that describes the test, and one line
per policy in the format of tests.jsonl.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from ..files import write_whole
from .decode import from_json
from .results import TestResult, decode_test, encode_test

FILE = "final.jsonl"


@dataclass(frozen=True)
class FinalTest:
    """The final test, episode by episode."""

    seed: int
    """Root of the test episodes' seeds."""
    last: TestResult
    best: TestResult | None
    """None if the checkpoint `best` could not be written or read."""
    last_sha256: str
    """Of the agent's state in the checkpoint `last`; it identifies the policy."""
    best_sha256: str | None


@dataclass(frozen=True)
class _Head:
    """The first line of the file: the root of the episodes' seeds, and sha256 of the agents' states."""

    seed: int
    last: str
    best: str | None


def write(folder: Path, final: FinalTest) -> None:
    """Write the final test of the run in this folder, whole or not at all.

    Raises:
        MachineError: the folder cannot be written.
    """
    head = asdict(_Head(final.seed, final.last_sha256, final.best_sha256))
    rows = [head, *(encode_test(result) for result in (final.last, final.best) if result is not None)]
    write_whole(folder / FILE, "".join(json.dumps(row, separators=(",", ":"), allow_nan=False) + "\n" for row in rows))


def read(folder: Path) -> FinalTest | None:
    """The final test of the run in this folder; None if there is none, or its file is damaged."""
    try:
        first, *lines, end = (folder / FILE).read_bytes().split(b"\n")
    except (OSError, ValueError):  # missing, or a single line
        return None
    head, tests = from_json(_Head, first), [test for line in lines if (test := decode_test(line)) is not None]
    if head is None or end or not len(lines) == len(tests) == (1 if head.best is None else 2):
        return None
    return FinalTest(head.seed, tests[0], None if head.best is None else tests[1], head.last, head.best)
