"""Tests of a run as counts: what the index and the listings need, without every return and distance.

Lines of tests.jsonl that look as `encode_test` writes them are counted as text, in a fifth of the time that their JSON
takes. A file with any other line, a torn one among them, is read the long way, by `decode_test`, and gives the same.
Digits among the returns, lengths and distances are not looked at: nothing here depends on them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from .results import TestResult

_FLAGS = rb"\[([01,]+)\]"
_NUMBERS = rb'\[([-+0-9.,eainf"]+)\]'  # nan and inf stand in quotes
_LINE = re.compile(
    rb'\{"steps":(0|[1-9]\d*),"seconds":(\d+\.\d+|\d+(?:\.\d+)?e[-+]\d+),"any":%b,"end":%b,"reset":%b,"returns":%b,"lengths":%b'
    rb'(?:,"distances":%b)?\}' % (_FLAGS, _FLAGS, _FLAGS, _NUMBERS, _NUMBERS, _NUMBERS)
)


@dataclass(frozen=True)
class TestCounts:
    """A test by its counts: `any`, `end`, `reset` are how many of the episodes, and mean what they do in TestResult."""

    __test__ = False  # not a test case, whatever its name says to pytest

    steps: int
    seconds: float
    episodes: int
    any: int
    end: int
    reset: int

    @property
    def success_any(self) -> float:
        """Share of episodes in which the goal was reached at some step."""
        return self.any / self.episodes

    @property
    def success_end(self) -> float:
        """Share of episodes in which the goal held at the last step."""
        return self.end / self.episodes

    @classmethod
    def of(cls, result: TestResult) -> TestCounts:
        counts = (sum(flags) for flags in (result.any, result.end, result.reset))
        return cls(int(result.steps), float(result.seconds), result.episodes, *counts)


def count_lines(data: bytes) -> list[TestCounts] | None:
    """The counts of a tests.jsonl, line by line; None where a line is not as `encode_test` writes it, or torn."""
    *lines, rest = data.split(b"\n")
    if rest:
        return None
    found = []
    for line in lines:
        match = _LINE.fullmatch(line)
        if match is None:
            return None
        steps, seconds, *lists = match.groups()
        flags, numbers = lists[:3], lists[3:]
        commas = flags[0].count(b",")
        # Flags alternate with commas: stripped of what belongs there, nothing is left.
        if any(len(part) != 2 * commas + 1 or part[::2].strip(b"01") or part[1::2].strip(b",") for part in flags):
            return None
        if any(part is not None and part.count(b",") != commas for part in numbers):
            return None
        any_, end, reset = (part.count(b"1") for part in flags)
        found.append(TestCounts(int(steps), float(seconds), commas + 1, any_, end, reset))
    return found
