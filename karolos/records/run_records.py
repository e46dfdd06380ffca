"""A run as frozen values: its state, its row in a listing, and the content of its folder."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Annotated, Any, Literal, NotRequired, get_args

from pydantic import Field, FiniteFloat
from typing_extensions import TypedDict

from .results import Count, MeasureMean, TestCounts

ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,199}")
"""A run's id: its name, seed and time."""
SWEEPS = "sweeps"
"""Folder of all sweeps in the runs folder; no run has this id."""
FORMAT = 1
"""Version of the folder's layout, in run.json."""
State = Literal["created", "running", "finished", "failed", "stopped", "lost"]
STATES: tuple[str, ...] = get_args(State)
"""A run's folder holds all but `lost`, which readers compute."""
UNFINISHED = ("created", "running")
THRESHOLD = 0.95
"""Lowest success at which a run counts as solved in steps_to_95 (`end`) and steps_to_95_any."""


def timestamp(time: datetime | None = None) -> str:
    """A time (now by default) as ISO 8601 in UTC with microseconds: as text it sorts like the time itself."""
    return (time or datetime.now(UTC)).astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


class GitCommit(TypedDict, total=False):
    """The commit of the work tree that a run was started in."""

    commit: str
    dirty: bool
    """Whether tracked files differed from it (code.diff)."""
    untracked: list[str]


class RunDescription(TypedDict):
    """The content of run.json."""

    format: int
    id: Annotated[str, Field(pattern=f"^{ID.pattern}$")]
    experiment: str
    """Hash of the settings that results depend on."""
    name: str
    """Of the experiment."""
    seed: Annotated[int, Field(ge=0, strict=True)]
    created: str
    """Time in UTC, ISO 8601."""
    continued_from: NotRequired[dict[str, Any]]
    """The run, and its steps, from whose end this one goes on."""
    changed: NotRequired[dict[str, Any] | None]
    """Settings that differ from their defaults; None if that is not known."""
    resolved_sha256: NotRequired[str]
    """Of the file resolved.json."""
    versions: NotRequired[dict[str, str]]
    """Of Python, karolos, plugins and their dependencies when the run began."""
    sources: NotRequired[dict[str, str]]
    """SHA-256 of karolos and of the packages and modules that the spec names."""
    unread: NotRequired[list[str]]
    """Files of these that do not count, and why."""
    files: NotRequired[dict[str, str] | None]
    """Key path -> SHA-256 of the file that the setting names, and of what that names."""
    machine: NotRequired[str]
    command: NotRequired[list[str]]
    git: NotRequired[GitCommit | None]


@dataclass(frozen=True)
class RunState:
    """The progress of a run."""

    state: State
    steps: Count = 0
    """Environment steps of training."""
    seconds: FiniteFloat = 0.0
    """Wall-clock seconds of collecting (demonstrations included) and learning; tests excluded."""
    attempt: Count = 1
    """Number of processes that have worked on it, from 1."""
    error: str | None = None
    """Why it failed, in one line."""
    updated: str = ""
    """When this was written (ISO 8601, UTC)."""
    updates: Count | None = None
    """Gradient updates; None if unknown."""
    total_seconds: FiniteFloat = 0.0
    """Wall-clock seconds of all processes that have worked on it, from start to end."""

    @property
    def unfinished(self) -> bool:
        """Whether a process should be working on it: if none does, the run is lost."""
        return self.state in UNFINISHED


@dataclass(frozen=True)
class RunSummary:
    """One run in one row. The first ten fields are what scripts rely on, in this order.

    Success and return are of the final test's policy `last`; before it, of the last test (None before the first).
    Success is None as well if the environment does not define it.
    """

    run: str
    """Id: the name of the folder."""
    experiment: str
    """Hash of the settings that results depend on."""
    seed: int
    state: str
    """created, running, finished, failed, stopped or lost."""
    steps: int
    """Environment steps of training."""
    seconds: float
    """Wall-clock seconds of collecting and learning."""
    success_any: float | None
    """Share of episodes that reached the goal at some step."""
    success_end: float | None
    """Share of episodes that reached the goal at the last step."""
    steps_to_95: int | None
    """Environment steps until the first test with `success_end` >= .95."""
    seconds_to_95: float | None
    """Seconds until then."""
    name: str
    """Of the experiment."""
    episodes: int | None
    """Episodes of the test that success and return are of: success_any * episodes is a whole number."""
    environment: str | None
    robot: str | None
    task: str | None
    agent: str | None
    attempt: int
    """How often the run was started or resumed."""
    error: str | None
    """Why it failed."""
    created: str
    """Time in UTC, ISO 8601."""
    updated: str
    folder: str
    tags: tuple[str, ...] = ()
    """In alphabetical order."""
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
    """That of the policy `best`."""
    measures: dict[str, MeasureMean] = field(default_factory=dict, hash=False)
    """By name, those of the test that success and return are of."""
    source: str | None = None
    """Hash of the plugins and modules of others that the spec names; None: it names none, or they are not known."""

    def row(self) -> dict[str, Any]:
        """The fields as JSON values, in order."""
        return asdict(self) | {"tags": list(self.tags)}


@dataclass(frozen=True)
class RunRecord:
    """The content of a run folder, as the index stores it."""

    summary: RunSummary
    spec: Mapping[str, Any]
    """Resolved; empty if its file is damaged."""
    tests: tuple[TestCounts, ...]
    """In the order of their steps."""
    versions: Mapping[str, str]
    """Of the software that made the run; empty if they are unknown."""
    problems: tuple[str, ...] = ()
    """One line per damaged file; not in the index."""


def flatten(spec: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """A nested mapping as pairs of key path and value: ("agent.learning_rate", 0.001). Lists are values."""
    for key, value in spec.items():
        path = f"{prefix}{key}"
        if isinstance(value, Mapping) and value:
            yield from flatten(value, f"{path}.")
        else:
            yield path, value


def part_name(spec: Mapping[str, Any], kind: str) -> str | None:
    """Name of a part (`robot`, `agent` ...) of a resolved spec, or None if it has none."""
    part = spec.get(kind)
    name = part.get("name") if isinstance(part, Mapping) else part
    return name if isinstance(name, str) else None
