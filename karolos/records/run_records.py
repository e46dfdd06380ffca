"""A run as frozen values: its state, its row in a listing, and the content of its folder."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ..errors import UsageError
from .decode import from_json
from .final_test import FinalTest
from .labels import Labels
from .results import TestCounts

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,199}")
"""A run's id: its name, seed and time."""
SWEEPS = "sweeps"
"""Folder of all sweeps in the runs folder; no run has this id."""
FORMAT = 1
"""Version of the folder's layout, in run.json."""
STORED_STATES = ("created", "running", "finished", "failed", "stopped")
UNFINISHED = ("created", "running")
STATES = (*STORED_STATES, "lost")
THRESHOLD = 0.95
"""Lowest success at which a run counts as solved in steps_to_95 (`end`) and steps_to_95_any."""


def timestamp(time: datetime | None = None) -> str:
    """A time (now by default) as ISO 8601 in UTC with microseconds: as text it sorts like the time itself."""
    return (time or datetime.now(UTC)).astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


@dataclass(frozen=True)
class RunState:
    """The progress of a run.

    Args:
        state: one of STATES.
        steps: environment steps of training.
        seconds: wall-clock seconds of collecting (demonstrations included) and learning; tests excluded.
        attempt: number of processes that have worked on it, from 1.
        error: why it failed, in one line.
        updated: when this was written (ISO 8601, UTC).
        updates: gradient updates; None if unknown.
        total_seconds: wall-clock seconds of all processes that have worked on it, from start to end.
    """

    state: str
    steps: int = 0
    seconds: float = 0.0
    attempt: int = 1
    error: str | None = None
    updated: str = ""
    updates: int | None = None
    total_seconds: float = 0.0

    def __post_init__(self) -> None:
        if self.state not in STATES:
            raise ValueError(f"{self.state!r} is not a state; there are {', '.join(STATES)}")

    @property
    def unfinished(self) -> bool:
        """Whether a process should be working on it: if none does, the run is lost."""
        return self.state in UNFINISHED

    def to_row(self) -> dict[str, Any]:
        if self.state not in STORED_STATES:
            raise ValueError(f"{self.state!r} is never written; readers compute it")
        return asdict(self)

    @classmethod
    def from_row(cls, row: Mapping[str, Any] | None) -> RunState | None:
        """The state in a JSON object; None if it is not a state."""
        return None if row is None else from_json(cls, {"state": "created", **row})


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

    def row(self) -> dict[str, Any]:
        """The fields as JSON values, in order."""
        return asdict(self) | {"tags": list(self.tags)}


@dataclass(frozen=True)
class RunRecord:
    """The content of a run folder; `problems` holds one line per damaged file."""

    summary: RunSummary
    spec: Mapping[str, Any]
    tests: tuple[TestCounts, ...]
    problems: tuple[str, ...]
    versions: Mapping[str, str] | None = None
    """Of Python, karolos, plugins and their dependencies when the run began; None if the folder does not hold them."""


def flatten(spec: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """A nested mapping as pairs of key path and value: ("agent.learning_rate", 0.001). Lists are values."""
    for key, value in spec.items():
        if isinstance(value, Mapping) and value:
            yield from flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def summarise(
    folder: Path,
    run: Mapping[str, Any],
    state: RunState,
    spec: Mapping[str, Any],
    tests: Sequence[TestCounts],
    *,
    final: FinalTest[TestCounts] | None,
    labels: Labels,
) -> RunSummary:
    """The row of a run from the content of its folder; `tests` in the order of their steps."""
    last = final.last if final else tests[-1] if tests else None
    best = final.best if final else None
    solved = next((test for test in tests if (test.success_end or 0) >= THRESHOLD), None)
    solved_any = next((test for test in tests if (test.success_any or 0) >= THRESHOLD), None)
    return RunSummary(
        run=str(run["id"]),
        experiment=str(run.get("experiment", "")),
        seed=int(run["seed"]),
        state=state.state,
        steps=state.steps,
        seconds=state.seconds,
        success_any=last.success_any if last else None,
        success_end=last.success_end if last else None,
        steps_to_95=solved.steps if solved else None,
        seconds_to_95=solved.seconds if solved else None,
        name=str(run["name"]),
        episodes=last.episodes if last else None,
        **{kind: part_name(spec, kind) for kind in ("environment", "robot", "task", "agent")},
        attempt=state.attempt,
        error=state.error,
        created=str(run["created"]),
        updated=state.updated or str(run["created"]),
        folder=str(folder),
        tags=labels.tags,
        note=labels.note,
        updates=state.updates,
        final=final is not None,
        best_steps=best.steps if best else None,
        best_any=best.success_any if best else None,
        best_end=best.success_end if best else None,
        steps_to_95_any=solved_any.steps if solved_any else None,
        seconds_to_95_any=solved_any.seconds if solved_any else None,
        total_seconds=state.total_seconds,
        mean_return=last.mean_return if last else None,
        best_return=best.mean_return if best else None,
    )


def part_name(spec: Mapping[str, Any], kind: str) -> str | None:
    """Name of a part (`robot`, `agent` ...) of a resolved spec, or None if it has none."""
    part = spec.get(kind)
    name = part.get("name") if isinstance(part, Mapping) else part
    return name if isinstance(name, str) else None


def check_name(name: str) -> None:
    """Refuse (UsageError) a run's name that cannot be a folder's on every system."""
    if not NAME.fullmatch(name):
        raise UsageError(
            f"a run cannot be named {name!r}",
            hint="up to 64 letters, digits, dots, dashes and underscores, beginning with a letter or digit",
        )


def is_description(run: Mapping[str, Any]) -> bool:
    """Whether an object has the fields of run.json, and each has its type."""
    git, versions, command = (run.get(key) for key in ("git", "versions", "command"))
    if not (isinstance(git, dict | None) and isinstance(versions, dict | None) and isinstance(command, list | None)):
        return False
    if not all(isinstance(text, str) for text in (*(versions or {}).values(), *(command or ()))):
        return False
    if not isinstance((git or {}).get("commit"), str | None) or run.get("id") == SWEEPS:
        return False
    texts = all(isinstance(run.get(key), str) for key in ("name", "experiment", "created"))
    numbers = all(type(run.get(key)) is int for key in ("seed", "format"))
    named = isinstance(run.get("id"), str) and ID.fullmatch(run["id"]) is not None
    return texts and numbers and named
