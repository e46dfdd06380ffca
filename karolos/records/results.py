"""The result of a test. Separate from `evaluation`, so that readers of results do not load what plays the episodes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import NoneType
from typing import Any

from ..files import parse_object
from ..statistics.intervals import wilson
from .decode import from_json

WITHIN = (0.05, 0.1, 0.25)
"""Distances in m: reports say which fraction of test episodes ended nearer to their goal."""


@dataclass(frozen=True)
class TestResult:
    """The result of one test, episode by episode. The lists hold one entry per test seed, in the order of the seeds.

    `any`: the goal was reached at some step; `end`: it held at the last step; `reset`: it held before the first action.
    `returns`: sums of rewards.
    """

    __test__ = False  # not a test case for pytest

    steps: int
    """Environment steps of training before the test."""
    seconds: float
    """Wall-clock seconds of collecting (demonstrations included) and learning before the test; tests excluded."""
    any: tuple[bool, ...]
    end: tuple[bool, ...]
    reset: tuple[bool, ...]
    returns: tuple[float, ...]
    lengths: tuple[int, ...]
    distances: tuple[float, ...] | None = None
    """From the goal at the last step, in m; inf where it does not count (nothing landed). None if it is unknown."""
    has_success: bool = True
    """False: the environment does not define success, and no episode has one. Only returns count."""

    @property
    def episodes(self) -> int:
        return len(self.any)

    @property
    def success_any(self) -> float:
        """Fraction of episodes in which the goal was reached at some step."""
        return sum(self.any) / self.episodes

    @property
    def success_end(self) -> float:
        """Fraction of episodes in which the goal held at the last step."""
        return sum(self.end) / self.episodes

    @property
    def mean_return(self) -> float:
        """nan if it is not finite."""
        mean = _finite_mean(self.returns)
        return math.nan if mean is None else mean

    @property
    def score(self) -> str:
        """Success and mean return as a text for a person."""
        success = f"success end {self.success_end:.2f}, any {self.success_any:.2f}, " if self.has_success else ""
        return f"{success}return {self.mean_return:,.2f}"

    @staticmethod
    def joined(parts: Sequence[TestResult]) -> TestResult:
        """The result of a test whose episodes were played in several parts."""
        names = ["any", "end", "reset", "returns", "lengths", "distances"]
        if any(part.distances is None for part in parts):
            names.remove("distances")
        lists: dict[str, Any] = {name: sum((getattr(part, name) for part in parts), ()) for name in names}
        has_success = any(part.has_success for part in parts)  # an environment may show its first success late
        return replace(parts[0], **{"distances": None, "has_success": has_success} | lists)

    def first(self, count: int) -> TestResult:
        """The result of the first `count` episodes."""
        return TestResult(
            self.steps,
            self.seconds,
            self.any[:count],
            self.end[:count],
            self.reset[:count],
            self.returns[:count],
            self.lengths[:count],
            None if self.distances is None else self.distances[:count],
            self.has_success,
        )

    def within(self, metres: float) -> float | None:
        """Fraction of episodes that ended nearer than this to their goal; None if the distances are unknown."""
        return None if self.distances is None else sum(far < metres for far in self.distances) / self.episodes


@dataclass(frozen=True)
class TestCounts:
    """One test in numbers, as the index stores it: episodes in which `any`, `end`, `reset` of TestResult hold.

    They are None where TestResult has no success. `mean_return` is None if it is not finite.
    """

    __test__ = False  # not a test case for pytest

    steps: int
    seconds: float
    episodes: int
    any: int | None
    end: int | None
    reset: int | None
    mean_return: float | None

    @property
    def success_any(self) -> float | None:
        """Fraction of episodes in which the goal was reached at some step."""
        return None if self.any is None else self.any / self.episodes

    @property
    def success_end(self) -> float | None:
        """Fraction of episodes in which the goal held at the last step."""
        return None if self.end is None else self.end / self.episodes

    @classmethod
    def of(cls, result: TestResult) -> TestCounts:
        some, end, reset = (
            sum(flags) if result.has_success else None for flags in (result.any, result.end, result.reset)
        )
        mean = _finite_mean(result.returns)
        return cls(int(result.steps), float(result.seconds), result.episodes, some, end, reset, mean)

    def row(self) -> dict[str, Any]:
        """Success and return as JSON values, with Wilson's intervals at 95 %."""
        return {
            "episodes": self.episodes,
            "success_any": self.success_any,
            "success_any_interval": None if self.any is None else wilson(self.any, self.episodes),
            "success_end": self.success_end,
            "success_end_interval": None if self.end is None else wilson(self.end, self.episodes),
            "mean_return": self.mean_return,
        }


def _finite_mean(values: Sequence[float]) -> float | None:
    """The mean, which is the same in every version of Python; None if it is not finite."""
    try:
        mean = math.fsum(values) / len(values)
    except (OverflowError, ValueError):
        return None
    return mean if math.isfinite(mean) else None


def encode_test(result: TestResult) -> dict[str, Any]:
    """A test as a JSON object; successes as 0 and 1, numbers that JSON lacks (nan, inf) as text."""
    return {
        "steps": int(result.steps),
        "seconds": float(result.seconds),
        "any": [int(flag) for flag in result.any],
        "end": [int(flag) for flag in result.end],
        "reset": [int(flag) for flag in result.reset],
        "mean_return": _finite_mean(result.returns),  # for `count_test`
        "returns": _numbers(result.returns),
        "lengths": [int(length) for length in result.lengths],
        **({} if result.distances is None else {"distances": _numbers(result.distances)}),
        **({} if result.has_success else {"has_success": False}),
    }


def _numbers(values: Sequence[float]) -> list[float | str]:
    return [value if math.isfinite(value) else str(value) for value in map(float, values)]


def decode_test(row: Mapping[str, Any]) -> TestResult | None:
    """The test in a JSON object, or None if it is not a test."""
    result = from_json(TestResult, row)
    if result is None:
        return None
    lists = [result.any, result.end, result.reset, result.returns, result.lengths]
    if result.distances is not None:
        lists.append(result.distances)
    whole = result.any and len({len(values) for values in lists}) == 1
    return result if whole and _is_time(result.steps, result.seconds) else None


def _is_time(steps: int, seconds: float) -> bool:
    """Whether a test can have been played after these steps and seconds."""
    return 0 <= steps < 1 << 63 and 0.0 <= seconds < math.inf


def count_test(line: bytes) -> TestCounts | None:
    """The counts of a line as `encode_test` makes it, or None for any other line.

    Reads the line up to the returns, and its lists as text, which takes a tenth of the time of `decode_test`.
    """
    head, _, rest = line.partition(b',"returns":[')
    without_success = rest.endswith(b'],"has_success":false}')
    if head.count(b'"') != 12 or not (without_success or rest.endswith(b"]}")):  # the quotes of six keys
        return None
    row = parse_object(head.replace(b":[", b':"').replace(b"],", b'",') + b"}")
    if row is None or list(row) != ["steps", "seconds", "any", "end", "reset", "mean_return"]:
        return None
    steps, seconds, *flags, mean = row.values()
    if type(steps) is not int or type(seconds) is not float or not _is_time(steps, seconds):
        return None
    if not all(isinstance(text, str) for text in flags) or type(mean) not in (float, NoneType):
        return None
    episodes = len(flags[0]) // 2 + 1
    separators = "," * (episodes - 1)
    for text in flags:
        if len(text) != 2 * episodes - 1 or text[1::2] != separators or text[::2].strip("01"):
            return None
    some, end, reset = (None if without_success else text.count("1") for text in flags)
    return TestCounts(steps, seconds, episodes, some, end, reset, mean)
