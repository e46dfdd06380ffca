"""Evaluation: one test of a policy. It is not in `karolos.evaluation`, because readers need no code that plays.

Every evaluation is one JSON object in one line: tests.jsonl holds the tests during training,
final.jsonl the final test of `last` and `best`, transfers.jsonl the tests under changed settings. The index has the
numbers of tests.jsonl in its table of tests, and those of the final test in the run's row.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from types import MappingProxyType
from typing import Annotated, Any, Literal, NotRequired, cast, final

from pydantic import Field, FiniteFloat
from typing_extensions import TypedDict

from ..system.files import parse_object
from .decode import from_json
from .intervals import wilson

Count = Annotated[int, Field(ge=0, lt=1 << 63)]
"""A number that databases can store."""
WITHIN = (0.05, 0.1, 0.25)
"""Distances in m. Reports show the fraction of test episodes that ended nearer to their goal."""
LISTS = ("any", "end", "reset", "returns", "lengths", "distances")
"""Fields that hold one entry per episode."""


class Mean(TypedDict):
    """A measure of an evaluation, without its episodes."""

    unit: str
    better: Literal["smaller", "larger"]
    """Whether smaller or larger values are better."""
    mean: FiniteFloat | None
    """Mean over the episodes in which it is defined; None if there are none."""


class Measured(Mean):
    """A measure of an evaluation."""

    values: NotRequired[tuple[FiniteFloat | None, ...]]
    """Value of each episode, None where it is undefined; missing in the index."""


class _Numbers(TypedDict):
    """The numbers of an evaluation, without its episodes."""

    steps: Count
    seconds: FiniteFloat
    episodes: Count
    successes_any: Count | None
    successes_end: Count | None
    solved_at_reset: Count | None
    mean_return: FiniteFloat | None
    measures: NotRequired[dict[str, Mean]]


COUNTS = tuple(_Numbers.__annotations__)
"""Fields that the index stores."""


@final
@dataclass(frozen=True)
class Evaluation:
    """One test of a policy: its numbers, its episodes, and the policy and conditions of the test.

    Lists have one entry per episode, in the order of the seeds. They are empty if only the numbers are known, as in the
    index. In tests during training, fields about the policy and the settings have their defaults.
    """

    steps: Count
    """Environment steps of training before the test."""
    seconds: FiniteFloat
    """Wall-clock seconds of collecting (demonstrations included) and learning before the test; tests excluded."""
    episodes: Count
    successes_any: Count | None
    """Episodes that reached the goal at some step; None if the environment does not define success."""
    successes_end: Count | None
    """Episodes that reached the goal at the last step."""
    solved_at_reset: Count | None
    """Episodes whose goal held before the first action."""
    mean_return: FiniteFloat | None
    """Mean over the episodes of the sum of rewards; None if it is not finite."""
    measures: dict[str, Measured] = field(default_factory=dict)
    """Measures of the episodes, by name; empty in tests of version 0.1."""
    any: tuple[bool, ...] = ()
    """Whether the goal was reached at some step."""
    end: tuple[bool, ...] = ()
    """Whether the goal held at the last step."""
    reset: tuple[bool, ...] = ()
    """Whether the goal held before the first action."""
    returns: tuple[float, ...] = ()
    """Sums of rewards."""
    lengths: tuple[int, ...] = ()
    """Number of steps."""
    distances: tuple[float, ...] | None = None
    """Distance to the goal at the last step, in m; inf if it does not count (nothing landed). None if unknown."""
    checkpoint: str | None = None
    """`last` or `best`; None during training."""
    sha256: str | None = None
    """SHA-256 of the agent's state in the checkpoint. It identifies the policy after the checkpoint is overwritten."""
    seed: int | None = None
    """Root of the seeds of the episodes; None during training, where it is `testing.seed`."""
    overrides: tuple[str, ...] = ()
    """Changes to the run's spec, as `path=value`."""
    randomized: bool = False
    """Whether domain randomization was on."""
    time: str | None = None
    """End of the test (ISO 8601, UTC)."""
    wall_seconds: float | None = None
    """Duration of the test."""
    versions: Mapping[str, str] = field(default_factory=dict)
    """Versions of the software that played."""
    causes: Mapping[str, int] = field(default_factory=dict)
    """Failed episodes by cause, of a robot's score."""
    own: Evaluation | None = None
    """Numbers of the same policy on the same episodes under the unchanged spec."""

    @classmethod
    def of(
        cls,
        steps: int,
        seconds: float,
        *,
        has_success: bool = True,
        measures: Mapping[str, Any] = MappingProxyType({}),
        **lists: Any,
    ) -> Evaluation:
        """The evaluation with these results: the fields LISTS, and unit, better and values of each measure by name.

        Without success only returns count.
        """
        some, end, reset = (sum(lists[name]) if has_success else None for name in ("any", "end", "reset"))
        means = {
            name: Measured(
                unit=one["unit"],
                better=one["better"],
                mean=_finite_mean([value for value in one["values"] if value is not None]),
                values=one["values"],
            )
            for name, one in measures.items()
        }
        mean = _finite_mean(lists["returns"])
        return cls(int(steps), float(seconds), len(lists["any"]), some, end, reset, mean, means, **lists)

    @classmethod
    def joined(cls, parts: Sequence[Evaluation], count: int | None = None) -> Evaluation:
        """The evaluation that joins parts, in the order of their episodes, or its first `count` episodes."""

        def whole(columns: Iterable[Any]) -> Any:
            known = list(columns)
            return None if None in known else tuple(chain.from_iterable(known))[:count]

        first = parts[0]
        measures = {
            name: {**one, "values": whole(part.measures[name]["values"] for part in parts)}
            for name, one in first.measures.items()
        }
        lists = {name: whole(getattr(part, name) for part in parts) for name in LISTS}
        has_success = any(part.has_success for part in parts)
        return cls.of(first.steps, first.seconds, has_success=has_success, measures=measures, **lists)

    @property
    def has_success(self) -> bool:
        """Whether the environment defines success."""
        return self.successes_end is not None

    @property
    def success_any(self) -> float | None:
        """Fraction of episodes in which the goal was reached at some step; None if success is not defined."""
        return None if self.successes_any is None else self.successes_any / self.episodes

    @property
    def success_end(self) -> float | None:
        """Fraction of episodes in which the goal held at the last step; None if success is not defined."""
        return None if self.successes_end is None else self.successes_end / self.episodes

    @property
    def known_return(self) -> float:
        """The mean return as a number: nan if it is not finite."""
        return math.nan if self.mean_return is None else self.mean_return

    @property
    def text(self) -> str:
        """Success and mean return for a person."""
        success = f"success end {self.success_end:.2f}, any {self.success_any:.2f}, " if self.has_success else ""
        return f"{success}return {self.known_return:,.2f}"

    @property
    def brief(self) -> str:
        """Success or return in a few characters."""
        return f"end {self.success_end:.2f}" if self.has_success else f"return {self.known_return:,.2f}"

    @property
    def counts(self) -> Evaluation:
        """Only the numbers, as in the index."""
        means = {
            name: Measured(unit=one["unit"], better=one["better"], mean=one["mean"])
            for name, one in self.measures.items()
        }
        return Evaluation(**{name: getattr(self, name) for name in COUNTS} | {"measures": means})

    def within(self, metres: float) -> float | None:
        """Fraction of episodes that ended nearer than this to their goal; None if the distances are unknown."""
        return None if self.distances is None else sum(far < metres for far in self.distances) / self.episodes

    def row(self) -> dict[str, Any]:
        """Success, return and measures as JSON values; success with Wilson's intervals at 95 %."""
        return {
            "episodes": self.episodes,
            "success_any": self.success_any,
            "success_any_interval": None if self.successes_any is None else self.interval(self.successes_any),
            "success_end": self.success_end,
            "success_end_interval": None if self.successes_end is None else self.interval(self.successes_end),
            "mean_return": self.mean_return,
            "measures": self.counts.measures,
        }

    def changed_row(self) -> dict[str, Any]:
        """A test under changed settings as JSON values. Scripts rely on the order."""
        return {
            "time": self.time,
            "checkpoint": self.checkpoint,
            "steps": self.steps,
            "overrides": list(self.overrides),
            "randomized": self.randomized,
            "seed": self.seed,
            **self.row(),
            "causes": dict(self.causes),
            "own": self.own and self.own.row(),
            "wall_seconds": self.wall_seconds,
        }

    def interval(self, successes: int) -> tuple[float, float]:
        """Wilson's interval at 95 % of a number of successes in these episodes."""
        return wilson(successes, self.episodes)

    def encode(self) -> dict[str, Any]:
        """As a JSON object, without fields that have their defaults. Successes are 0 and 1, nan and inf are texts."""
        row: dict[str, Any] = dict(vars(self))
        row |= {name: [int(flag) for flag in row[name]] for name in ("any", "end", "reset", "lengths")}
        for name in ("returns", "distances"):
            row[name] = [value if math.isfinite(value) else str(value) for value in map(float, row[name] or ())]
        row |= {"randomized": self.randomized or None, "own": self.own and self.own.counts.encode()}
        return {name: value for name, value in row.items() if name in COUNTS or value not in (None, [], (), {})}


def _finite_mean(values: Sequence[float]) -> float | None:
    """The mean, equal in every version of Python; None if it is not finite or there are no values."""
    try:
        mean = math.fsum(values) / len(values)
    except (OverflowError, ValueError, ZeroDivisionError):
        return None
    return mean if math.isfinite(mean) else None


def decode(line: bytes | Mapping[str, Any]) -> Evaluation | None:
    """The evaluation in a JSON object or its text, with all episodes; None if it is not one."""
    found = from_json(Evaluation, line)
    if found is None or not found.any:
        found = _decode_older(line)
    if found is None or not found.any:
        return None
    lists = [getattr(found, name) for name in LISTS] + [one.get("values") for one in found.measures.values()]
    return found if all(len(one) == found.episodes for one in lists if one is not None) else None


def decode_counts(line: bytes) -> Evaluation | None:
    """Only the numbers of an evaluation, as in the index: lists of episodes are not read, which takes twice as long."""
    if (numbers := from_json(_Numbers, line)) is not None:
        return Evaluation(**cast("Any", numbers))
    whole = decode(line)
    return whole and whole.counts


def _decode_older(line: bytes | Mapping[str, Any]) -> Evaluation | None:
    """A line of version 0.1 without counts, or of transfers.jsonl in 0.2 with a nested test."""
    row = parse_object(line) if isinstance(line, bytes) else line
    if row is None or "successes_end" in row:
        return None
    if isinstance(row.get("test"), Mapping):
        return decode({**row, "test": None, **row["test"]})
    unknown = dict.fromkeys(COUNTS[2:-1], 0) | {"successes_end": None if row.get("has_success") is False else 0}
    found = from_json(Evaluation, unknown | {**row})
    if found is None:
        return None
    counted = Evaluation.joined([found])
    return replace(found, **{name: getattr(counted, name) for name in COUNTS})


def decode_final(text: bytes) -> dict[str, Evaluation]:
    """The final test in the lines of a file: checkpoint -> evaluation; empty if they are damaged."""
    lines = text.splitlines()
    head = parse_object(lines[0]) if lines else None
    if head is None or not text.endswith(b"\n"):
        return {}
    older = {name: head[name] for name in ("last", "best") if isinstance(head.get(name), str)}
    found = [one for one in map(decode, lines[bool(older) :]) if one is not None]
    if not older:
        named = {str(one.checkpoint): one for one in found}
        return named if len(found) == len(lines) and "last" in named else {}
    # Up to 0.2 the first line describes the policies. Equal policies have one line, in 0.1 two.
    if len(found) != len(lines) - 1 or len(found) not in (len({*older.values()}), len(older)):
        return {}
    return {
        name: replace(one, checkpoint=name, sha256=older[name], seed=head.get("seed"))
        for name, one in zip(older, (found[0], found[-1]), strict=False)
    }
