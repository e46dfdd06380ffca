"""The result of a test. Separate from `evaluation`, so that readers of results do not load what plays the episodes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import chain
from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat
from typing_extensions import TypedDict

from ..statistics.intervals import wilson
from .decode import from_json

Count = Annotated[int, Field(ge=0, lt=1 << 63)]
"""A number that databases can store."""
WITHIN = (0.05, 0.1, 0.25)
"""Distances in m: reports say which fraction of test episodes ended nearer to their goal."""


class MeasureMean(TypedDict):
    """A measure of a test."""

    unit: str
    better: Literal["smaller", "larger"]
    """Which of two values is better."""
    mean: FiniteFloat | None
    """Over the episodes in which it is defined; None without any."""


class MeasureValues(TypedDict):
    """A measure of a test, episode by episode; None where it is undefined."""

    unit: str
    better: Literal["smaller", "larger"]
    values: tuple[FiniteFloat | None, ...]


@dataclass(frozen=True)
class TestResult:
    """The result of one test, episode by episode. The lists hold one entry per test seed, in the order of the seeds.

    `any`: the goal was reached at some step; `end`: it held at the last step; `reset`: it held before the first action.
    `returns`: sums of rewards.
    """

    __test__ = False  # not a test case for pytest

    steps: Count
    """Environment steps of training before the test."""
    seconds: FiniteFloat
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
    measures: dict[str, MeasureValues] = field(default_factory=dict)
    """What the environment measures an episode by, by name; empty in tests from before there were measures."""

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

    def first(self, count: int) -> TestResult:
        """The result of the first `count` episodes."""
        lists: dict[str, Any] = {
            name: values[:count] for name, values in vars(self).items() if isinstance(values, tuple)
        }
        measures: dict[str, MeasureValues] = {
            name: {**one, "values": one["values"][:count]} for name, one in self.measures.items()
        }
        return replace(self, measures=measures, **lists)

    @classmethod
    def joined(cls, parts: Sequence[TestResult]) -> TestResult:
        """The result of a test that was played in parts, in the order of their episodes."""
        first = parts[0]
        columns: dict[str, list[Any]] = {
            name: [getattr(part, name) for part in parts]
            for name, values in vars(first).items()
            if isinstance(values, tuple)
        }
        lists: dict[str, Any] = {
            name: None if None in values else tuple(chain.from_iterable(values)) for name, values in columns.items()
        }
        measures: dict[str, MeasureValues] = {
            name: {**one, "values": tuple(chain.from_iterable(part.measures[name]["values"] for part in parts))}
            for name, one in first.measures.items()
        }
        return replace(first, has_success=any(part.has_success for part in parts), measures=measures, **lists)

    def within(self, metres: float) -> float | None:
        """Fraction of episodes that ended nearer than this to their goal; None if the distances are unknown."""
        return None if self.distances is None else sum(far < metres for far in self.distances) / self.episodes


@dataclass(frozen=True)
class TestCounts:
    """One test in numbers, as its line in tests.jsonl begins and as the index stores it."""

    __test__ = False  # not a test case for pytest

    steps: Count
    """Environment steps of training before the test."""
    seconds: FiniteFloat
    """Wall-clock seconds of collecting and learning before the test."""
    episodes: Count
    successes_any: Count | None
    """Episodes that reached the goal at some step; None if the environment does not define success."""
    successes_end: Count | None
    """Episodes that reached the goal at the last step."""
    solved_at_reset: Count | None
    """Episodes whose goal held before the first action."""
    mean_return: FiniteFloat | None
    """Mean over the episodes of the sum of rewards; None if it is not finite."""
    measures: dict[str, MeasureMean] = field(default_factory=dict)
    """By name."""

    @property
    def success_any(self) -> float | None:
        """Fraction of episodes in which the goal was reached at some step."""
        return None if self.successes_any is None else self.successes_any / self.episodes

    @property
    def success_end(self) -> float | None:
        """Fraction of episodes in which the goal held at the last step."""
        return None if self.successes_end is None else self.successes_end / self.episodes

    @classmethod
    def of(cls, result: TestResult) -> TestCounts:
        some, end, reset = (
            sum(flags) if result.has_success else None for flags in (result.any, result.end, result.reset)
        )
        mean = _finite_mean(result.returns)
        means = measure_means(result.measures)
        return cls(int(result.steps), float(result.seconds), result.episodes, some, end, reset, mean, means)

    def row(self) -> dict[str, Any]:
        """Success, return and measures as JSON values; success with Wilson's intervals at 95 %."""
        return {
            "episodes": self.episodes,
            "success_any": self.success_any,
            "success_any_interval": self._interval(self.successes_any),
            "success_end": self.success_end,
            "success_end_interval": self._interval(self.successes_end),
            "mean_return": self.mean_return,
            "measures": self.measures,
        }

    def _interval(self, successes: int | None) -> tuple[float, float] | None:
        return None if successes is None else wilson(successes, self.episodes)


def _finite_mean(values: Sequence[float]) -> float | None:
    """The mean, which is the same in every version of Python; None if it is not finite, or without values."""
    try:
        mean = math.fsum(values) / len(values)
    except (OverflowError, ValueError, ZeroDivisionError):
        return None
    return mean if math.isfinite(mean) else None


def measure_means(measures: Mapping[str, MeasureValues]) -> dict[str, MeasureMean]:
    """The mean of each measure over its episodes."""
    return {
        name: {
            "unit": one["unit"],
            "better": one["better"],
            "mean": _finite_mean([value for value in one["values"] if value is not None]),
        }
        for name, one in measures.items()
    }


def encode_test(result: TestResult) -> dict[str, Any]:
    """A test as a JSON object: its counts, then its episodes. Successes are 0 and 1, nan and inf are texts."""
    counts = asdict(TestCounts.of(result))
    return {
        **counts,
        "any": [int(flag) for flag in result.any],
        "end": [int(flag) for flag in result.end],
        "reset": [int(flag) for flag in result.reset],
        "returns": _numbers(result.returns),
        "lengths": [int(length) for length in result.lengths],
        **({} if result.distances is None else {"distances": _numbers(result.distances)}),
        **({} if result.has_success else {"has_success": False}),
        "measures": {name: counts["measures"][name] | one for name, one in result.measures.items()},
    }


def _numbers(values: Sequence[float]) -> list[float | str]:
    return [value if math.isfinite(value) else str(value) for value in map(float, values)]


def decode_test(test: bytes | Mapping[str, Any]) -> TestResult | None:
    """The test in a JSON object or its text; None if it is not a test. Its counts alone: `from_json(TestCounts)`."""
    result = from_json(TestResult, test)
    if result is None:
        return None
    lists: list[tuple[Any, ...]] = [
        result.any,
        result.end,
        result.reset,
        result.returns,
        result.lengths,
        result.distances or result.any,
    ]
    lists += [one["values"] for one in result.measures.values()]
    return result if result.any and len(set(map(len, lists))) == 1 else None


@dataclass(frozen=True)
class FinalTest:
    """The final test of a run, episode by episode: `last` and `best` on episodes that nothing was chosen on.

    In final.jsonl, one line describes the test, and one line per policy is in the format of tests.jsonl: one in all if
    `last` is the best.
    """

    seed: int
    """Root of the test episodes' seeds."""
    last: TestResult
    best: TestResult | None
    """None if the checkpoint `best` could not be written or read."""
    last_sha256: str
    """Of the agent's state in the checkpoint `last`; it identifies the policy."""
    best_sha256: str | None


class _Head(TypedDict):
    """The first line of a final test: the root of the episodes' seeds, and sha256 of the agents' states."""

    seed: int
    last: str
    best: str | None


def encode_final(final: FinalTest) -> list[dict[str, Any]]:
    """A final test as JSON objects."""
    head = {"seed": final.seed, "last": final.last_sha256, "best": final.best_sha256}
    others = () if final.best is None or final.best_sha256 == final.last_sha256 else (final.best,)
    return [head, *(encode_test(result) for result in (final.last, *others))]


def decode_final(text: bytes) -> FinalTest | None:
    """The final test in the lines of a file; None if they are damaged."""
    first, *lines = text.splitlines()
    head, tests = from_json(_Head, first), [test for line in lines if (test := decode_test(line)) is not None]
    if head is None or not text.endswith(b"\n") or len(lines) != len(tests):
        return None
    most = 1 if head["best"] is None else 2  # runs of 0.1 have two lines also where `last` is the best
    if not (1 if head["best"] == head["last"] else most) <= len(tests) <= most:
        return None
    return FinalTest(head["seed"], tests[0], None if head["best"] is None else tests[-1], head["last"], head["best"])
