"""One run's folder: made, locked, written and read."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

from ..errors import RunError, UsageError
from ..files import FileLock, append_lines, read_lines, write_json, write_whole, writing
from . import labels, provenance
from .labels import Labels
from .making import check_writable, make_folder
from .reading import count_tests, read_description, read_object, read_state, read_tests
from .results import TestResult
from .run_records import FORMAT, RunRecord, RunState, RunSummary, check_name, encode_test, summarise, timestamp

LOCK_SECONDS = 0.5
"""A reader that looks whether a run lives holds the lock for an instant; its owner waits that long for it."""


class RunFolder:
    """One run's folder. Get one from `create` (new, locked) or `open`; use it in a `with` to free the lock at the end.

    Raises:
        MachineError: from every method that writes, when the disk is full or the folder cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.id = path.name
        self.checkpoints = path / "checkpoints"
        self.tensorboard = path / "tensorboard"
        self._lock = FileLock(path / "lock")
        self._run: dict[str, Any] = {}

    @classmethod
    def create(cls, runs: str | Path, name: str, seed: int) -> RunFolder:
        """Make `runs/<name>-s<seed>-<UTC date>-<time>` and lock it; `-2`, `-3` ... is added to a name that is taken.

        Raises:
            UsageError: the name cannot be a folder's, or the seed is negative.
            MachineError: the runs folder cannot be written.
        """
        check_name(name)
        if seed < 0:
            raise UsageError(f"the seed is {seed}", hint="seeds are not negative")
        now = datetime.now(UTC)
        path = make_folder(Path(runs), f"{name}-s{seed}-{now:%Y%m%d-%H%M%S}")
        folder = cls(path)
        folder.lock()
        folder._run = {"format": FORMAT, "id": path.name, "name": name, "seed": seed, "created": timestamp(now)}
        return folder

    @classmethod
    def open(cls, path: str | Path) -> RunFolder:
        """An existing run's folder, to read it or, after `lock()`, to go on with it.

        Raises:
            RunError: it is no run folder, or a newer karolos made it.
        """
        folder = cls(Path(path))
        run = read_description(folder.path)
        folder._run = run
        folder.id = run["id"]  # a folder that was renamed is still the same run
        return folder

    check_writable = staticmethod(check_writable)

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def lock(self) -> None:
        """Claim the run for this process until `release` or its death.

        Raises:
            RunError: another process has it.
        """
        if not self._lock.acquire(LOCK_SECONDS):
            raise RunError("another process is running it", where=self.id, hint="wait for it, or stop it first")

    def release(self) -> None:
        """Give the run back. Safe to call twice."""
        self._lock.release()

    def is_locked(self) -> bool:
        """Whether a process that lives has the run."""
        return self._lock.is_locked()

    def describe(
        self,
        resolved: Mapping[str, Any],
        *,
        experiment: str,
        text: str | None = None,
        source: Path | None = None,
    ) -> None:
        """Write what the run is made from. The folder counts as a run from here on, because run.json comes last.

        Args:
            resolved: the spec with every default filled in, as JSON values.
            experiment: hash of that spec without seeds and operational fields.
            text: the spec as its author wrote it.
            source: the folder whose git work tree is recorded; the current one by default.
        """
        code = provenance.code(source or Path.cwd())
        if text is not None:
            write_whole(self.path / "spec.yaml", text)
        if code and code.diff:
            write_whole(self.path / "code.diff", code.diff)
        write_json(self.path / "resolved.json", resolved)
        self._run |= {
            "experiment": experiment,
            "versions": provenance.versions(),
            "machine": provenance.kind_of_machine(),
            "command": provenance.command_line(),
            "git": {"commit": code.commit, "dirty": code.dirty, "untracked": list(code.untracked)} if code else None,
        }
        self._write_state(RunState("created", updated=timestamp()))
        write_json(self.path / "run.json", self._run)

    def description(self) -> dict[str, Any]:
        """What run.json holds: id, experiment, name, seed, created, versions, command, git."""
        return dict(self._run)

    def spec(self) -> dict[str, Any]:
        """The resolved spec; empty where its file is missing or damaged (`record().problems` says so)."""
        return read_object(self.path / "resolved.json") or {}

    def set_state(
        self, state: str, *, steps: int | None = None, seconds: float | None = None, error: str | None = None
    ) -> None:
        """Replace the state; steps and seconds stay as they are when not given.

        Args:
            state: created, running, finished, failed or stopped.
            steps: environment steps of training so far.
            seconds: wall-clock seconds of collecting and learning so far.
            error: why it failed, in one line.
        """
        before = read_state(self.path)
        steps = before.steps if steps is None else int(steps)
        seconds = before.seconds if seconds is None else float(seconds)
        self._write_state(RunState(state, steps, seconds, before.attempt, error, timestamp()))

    def next_attempt(self) -> int:
        """Count one more process that goes on with this run; returns its number, from 1."""
        before = read_state(self.path)
        attempt = before.attempt + 1
        self._write_state(RunState("created", before.steps, before.seconds, attempt, None, timestamp()))
        return attempt

    def labels(self) -> Labels:
        """Tags and note; empty where nobody wrote any."""
        return labels.read(self.path)

    def event(self, kind: str, **data: Any) -> None:
        """Note that something happened; `data` are JSON values."""
        append_lines(self.path / "events.jsonl", [{"time": timestamp(), "event": kind, **data}])

    def events(self) -> tuple[dict[str, Any], ...]:
        """What happened, in order; lines that cannot be read are left out and named by `record().problems`."""
        return read_lines(self.path / "events.jsonl").rows

    def add_test(self, result: TestResult) -> None:
        """Keep a test's result for good: it is on the disk when this returns."""
        append_lines(self.path / "tests.jsonl", [encode_test(result)])

    def episodes_bytes(self) -> int:
        """How long episodes.jsonl is, for `cut_episodes` after the process died."""
        path = self.path / "episodes.jsonl"
        return path.stat().st_size if path.exists() else 0

    def cut_episodes(self, size: int) -> None:
        """Forget the training episodes after this many bytes: a run that goes on plays them again."""
        path = self.path / "episodes.jsonl"
        if path.exists() and path.stat().st_size > size:
            with writing(path):
                os.truncate(path, size)

    def add_episodes(self, episodes: Iterable[Mapping[str, Any]]) -> None:
        """Keep the records of training episodes, JSON values each."""
        append_lines(self.path / "episodes.jsonl", episodes)

    def tests(self) -> tuple[TestResult, ...]:
        """The tests in the order of their steps; of two at the same step the later written, as a resumed run makes.

        Lines that cannot be read are left out and named by `record().problems`.
        """
        return read_tests(self.path)[0]

    def state(self) -> RunState:
        """The state now, `lost` included."""
        stored = read_state(self.path)
        if stored.unfinished and not self.is_locked():
            stored = read_state(self.path)  # it may have ended, and said so, between the two looks
            return stored.as_lost() if stored.unfinished else stored
        return stored

    def summary(self) -> RunSummary:
        """The run in one row, as the store keeps it."""
        return summarise(
            self.path.resolve(), self._run, self.state(), self.spec(), count_tests(self.path)[0], self.labels()
        )

    def record(self) -> RunRecord:
        """All that the folder says, read once, and what is damaged or missing in it."""
        tests, problems = count_tests(self.path)
        spec = self.spec()
        for name in ("resolved.json", "state.json"):
            if read_object(self.path / name) is None:
                problems += (f"{name}: missing or damaged",)
        if labels.is_damaged(self.path):
            problems += ("labels.json: damaged; tags and note cannot be read",)
        summary = summarise(self.path.resolve(), self._run, self.state(), spec, tests, self.labels())
        problems += read_lines(self.path / "events.jsonl").problems
        return RunRecord(summary, spec, tests, problems, self.versions())

    def versions(self) -> dict[str, str] | None:
        """Versions of what the run was made with; None where run.json does not tell."""
        found = self._run.get("versions")
        return {str(name): str(version) for name, version in found.items()} if isinstance(found, dict) else None

    def _write_state(self, state: RunState) -> None:
        write_json(self.path / "state.json", state.to_row())
