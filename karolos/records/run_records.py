"""A run as frozen values: its row in a listing, and its record in the folder and the index."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Annotated, Any, Literal, NotRequired, get_args

from pydantic import Field, FiniteFloat
from typing_extensions import TypedDict

from ..errors import UsageError
from .evaluation import Count, Evaluation, Measured

ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,199}")
"""A run's id: its name, seed and time."""
SWEEPS = "sweeps"
"""Folder of all sweeps in the runs folder; no run has this id."""
FORMAT = 1
"""Version of the folder's layout, in run.json."""
StateName = Literal["created", "running", "finished", "failed", "stopped", "lost"]
STATES: tuple[str, ...] = get_args(StateName)
"""States of a run. Its folder never holds `lost`, which readers compute."""
UNFINISHED = ("created", "running")
Success = Literal["any", "end"]
"""How success is counted: the goal is reached at any step, or at the last step."""
Metric = Literal["any", "end", "return"]
"""Quantity of a comparison: a success ratio, or the mean return."""
THRESHOLD = 0.95
"""Lowest success at which a run counts as solved in steps_to_95 (`end`) and steps_to_95_any."""


def timestamp(time: datetime | None = None) -> str:
    """A time (now by default) as ISO 8601 in UTC with microseconds: as text it sorts like the time itself."""
    return (time or datetime.now(UTC)).astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


class GitCommit(TypedDict, total=False):
    """The commit of the work tree that a run was started in."""

    commit: str
    """Commit in hexadecimal digits."""
    dirty: bool
    """Whether tracked files differed from it (code.diff)."""
    untracked: list[str]
    """Files that git neither tracks nor ignores; the first 50."""


class RunDescription(TypedDict):
    """The content of run.json."""

    format: int
    id: Annotated[str, Field(pattern=f"^{ID.pattern}$")]
    experiment: str
    """Hash of the settings that change results."""
    name: str
    """Name of the experiment."""
    seed: Annotated[int, Field(ge=0, strict=True)]
    created: str
    """Time in UTC, ISO 8601."""
    continued_from: NotRequired[dict[str, Any]]
    """The run that this one continues, and its number of steps."""
    changed: NotRequired[dict[str, Any] | None]
    """Settings that differ from their defaults; None if that is not known."""
    resolved_sha256: NotRequired[str]
    """SHA-256 of the file resolved.json."""
    versions: NotRequired[dict[str, str]]
    """Versions of Python, karolos, plugins and their dependencies when the run began."""
    sources: NotRequired[dict[str, str]]
    """SHA-256 of karolos and of the packages and modules that the spec names."""
    unread: NotRequired[list[str]]
    """Ignored files of these, with the reasons."""
    files: NotRequired[dict[str, str] | None]
    """Key path -> SHA-256 of the file that the setting names, including the files named there."""
    machine: NotRequired[str]
    command: NotRequired[list[str]]
    git: NotRequired[GitCommit | None]


@dataclass(frozen=True)
class RunState:
    """The progress of a run. `RunSummary` explains the fields."""

    state: StateName
    steps: Count = 0
    seconds: FiniteFloat = 0.0
    attempt: Count = 1
    error: str | None = None
    updated: str = ""
    updates: Count | None = None
    total_seconds: FiniteFloat = 0.0

    @property
    def unfinished(self) -> bool:
        """Whether a process should work on it. If none does, the run is lost."""
        return self.state in UNFINISHED


@dataclass(frozen=True)
class RunSummary:
    """One run in one row. The first ten fields are what scripts rely on, in this order.

    Success and return are of the final test's policy `last`; before it, of the last test (None before the first).
    Success is also None if the environment does not define it.
    """

    run: str
    """Id: the name of the folder."""
    experiment: str
    """Hash of the settings that change results."""
    seed: int
    state: str
    """created, running, finished, failed, stopped or lost."""
    steps: int
    """Environment steps of training."""
    seconds: float
    """Wall-clock seconds of collecting (demonstrations included) and learning; tests excluded."""
    success_any: float | None
    """Share of episodes that reached the goal at some step."""
    success_end: float | None
    """Share of episodes that reached the goal at the last step."""
    steps_to_95: int | None
    """Environment steps until the first test with `success_end` >= .95."""
    seconds_to_95: float | None
    """Seconds until then."""
    name: str
    """Name of the experiment."""
    episodes: int | None
    """Number of episodes of the test that gives success and return. success_any * episodes is a whole number."""
    environment: str | None
    robot: str | None
    task: str | None
    agent: str | None
    attempt: int
    """Number of processes that have worked on it, from 1."""
    error: str | None
    """Why it failed, in one line."""
    created: str
    """Time in UTC, ISO 8601."""
    updated: str
    """When its state was written."""
    folder: str
    tags: tuple[str, ...] = ()
    """Tags in alphabetical order."""
    note: str | None = None
    updates: int | None = None
    """Gradient updates; None if unknown."""
    final: bool = False
    """Whether success is that of the final test."""
    best_steps: int | None = None
    """Environment steps of the policy `best`; None before the final test."""
    best_any: float | None = None
    """Success of the policy `best` in the final test."""
    best_end: float | None = None
    steps_to_95_any: int | None = None
    """Environment steps until the first test with `success_any` >= .95."""
    seconds_to_95_any: float | None = None
    total_seconds: float = 0.0
    """Wall-clock seconds from start to end, of all attempts: `seconds`, tests, checkpoints and everything else."""
    mean_return: float | None = None
    """Mean over the episodes of the sum of rewards."""
    best_return: float | None = None
    """Mean return of the policy `best`."""
    measures: dict[str, Measured] = field(default_factory=dict, hash=False)
    """Measures by name, of the test that gives success and return."""
    source: str | None = None
    """Hash of the foreign plugins and modules that the spec names; None: there are none, or they are unknown."""

    def row(self) -> dict[str, Any]:
        """The fields as JSON values, in order."""
        return vars(self) | {"tags": list(self.tags)}


@dataclass(frozen=True)
class RunRecord:
    """A run with its tests, as its folder and the index have it."""

    summary: RunSummary
    spec: Mapping[str, Any]
    """Resolved spec, in the index without its seeds; empty if its file is damaged."""
    tests: tuple[Evaluation, ...]
    """Numbers of the tests during training, in the order of their steps."""
    versions: Mapping[str, str]
    """Versions of the software that made the run; empty if they are unknown."""
    commit: str | None = None
    """Git commit, with a + when files differed from it."""
    problems: tuple[str, ...] = ()
    """One line per damaged file; not in the index."""

    @property
    def has_success(self) -> bool:
        """Whether a test knows its number of successes."""
        return self.summary.success_end is not None or any(test.has_success for test in self.tests)

    def values(self, metric: Metric) -> tuple[float, ...]:
        """Success ratio or mean return of each test."""
        if metric == "return":
            return tuple(test.known_return for test in self.tests)
        return tuple((test.success_any if metric == "any" else test.success_end) or 0.0 for test in self.tests)

    def reported(self, metric: Metric) -> float:
        """Success ratio or mean return of the final test's policy `last`; without a final test, of the last test.

        nan of a return that is not finite.
        """
        summary = self.summary
        final = {"any": summary.success_any, "end": summary.success_end, "return": summary.mean_return}[metric]
        if summary.final and (final is not None or metric == "return"):
            return math.nan if final is None else final
        return self.values(metric)[-1]

    def measured(self, name: str) -> float | None:
        """The mean of a measure over the episodes of the reported test; None if it is unknown."""
        measure = self.summary.measures.get(name)
        return None if measure is None else measure["mean"]

    @property
    def episodes(self) -> int:
        """Number of episodes of the reported test."""
        return (self.summary.episodes if self.summary.final else None) or self.tests[-1].episodes

    @property
    def finished(self) -> bool:
        return self.summary.state == "finished"

    @property
    def updates_per_second(self) -> float | None:
        """Gradient updates per second of collecting and learning; None if they are unknown."""
        updates, seconds = self.summary.updates, self.summary.seconds
        return updates / seconds if updates is not None and seconds else None

    def at(self, steps: int) -> RunRecord:
        """The run as it was at its test nearest to this number of environment steps.

        Raises UsageError if that is more than a tenth away.
        """
        nearest = min(self.tests, key=lambda test: abs(test.steps - steps))
        if abs(nearest.steps - steps) > steps / 10:
            raise UsageError(
                f"{self.summary.run} has no test near {steps:,} steps",
                where="--at",
                hint=f"its nearest is at {nearest.steps:,}; name a number of steps at which all runs were tested",
            )
        summary = replace(
            self.summary,
            state="finished",
            steps=nearest.steps,
            seconds=nearest.seconds,
            updates=None,  # tests do not say
            success_any=nearest.success_any,
            success_end=nearest.success_end,
            mean_return=nearest.mean_return,
            episodes=nearest.episodes,
            measures=nearest.measures,
            final=False,
            best_steps=None,
            best_any=None,
            best_end=None,
            best_return=None,
        )
        return replace(self, summary=summary, tests=tuple(test for test in self.tests if test.steps <= nearest.steps))


def flatten(spec: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """A nested mapping as pairs of key path and value: ("agent.learning_rate", 0.001). Lists are values."""
    for key, value in spec.items():
        path = f"{prefix}{key}"
        if isinstance(value, Mapping) and value:
            yield from flatten(value, f"{path}.")
        else:
            yield path, value


def without_seeds(spec: Mapping[str, Any]) -> dict[str, Any]:
    """A resolved spec without its seeds: runs of an experiment share it."""
    return {key: value for key, value in spec.items() if key != "seeds"}


def part_name(spec: Mapping[str, Any], kind: str) -> str | None:
    """Name of a part (`robot`, `agent` ...) of a resolved spec, or None if it has none."""
    part = spec.get(kind)
    name = part.get("name") if isinstance(part, Mapping) else part
    return name if isinstance(name, str) else None
