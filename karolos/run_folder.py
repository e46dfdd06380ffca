"""The run folder: the truth about one run, in files that anybody can read.

    spec.yaml       the spec as its author wrote it, if there was a file
    resolved.json   the spec with every default filled in
    run.json        id, experiment, name, seed, time, versions, command line, git commit
    code.diff       how the code differed from that commit
    state.json      state, steps, seconds, attempt, error; replaced as a whole
    tests.jsonl     one line per test
    events.jsonl    one line per thing that happened
    episodes.jsonl  one line per training episode, with what domain randomization drew
    tensorboard/    series
    checkpoints/    best and last
    export/         its policy for use without karolos, if somebody asked for it
    transfers.jsonl one line per test of its policy under changed settings
    labels.json     tags and note, whoever wrote them
    lock            held by the process that runs it, for as long as it lives

Only the process that holds the lock writes, but for transfers.jsonl and labels.json, which have locks of their own. The
state `lost` is never written: whoever reads `created` or `running` and finds the lock free knows that the process died.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path
from types import TracebackType
from typing import Any

from . import labels, provenance
from .counting import TestCounts, count_lines
from .errors import MachineError, RunError, UsageError
from .files import FileLock, append_lines, parse_object, read_lines, write_json, write_whole, writing
from .labels import Labels
from .results import TestResult
from .run_records import (
    FORMAT,
    RunRecord,
    RunState,
    RunSummary,
    check_name,
    decode_test,
    encode_test,
    is_description,
    summarise,
    timestamp,
)

LOCK_SECONDS = 0.5
"""A reader that looks whether a run lives holds the lock for an instant; its owner waits that long for it."""
_FOLDERS = 10_000


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
        root, now = Path(runs), datetime.now(UTC)
        stem = f"{name}-s{seed}-{now:%Y%m%d-%H%M%S}"
        with writing(root):
            root.mkdir(parents=True, exist_ok=True)
            for attempt in range(1, _FOLDERS):
                path = root / (stem if attempt == 1 else f"{stem}-{attempt}")
                try:
                    path.mkdir()  # by one process only, however many try
                except FileExistsError:
                    continue
                break
            else:
                raise MachineError(f"{stem} is taken", where=str(root))
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
        try:
            run = parse_object((folder.path / "run.json").read_bytes())
        except OSError as error:
            raise RunError(
                f"this is no run folder ({error.strerror})", where=str(path), hint="`karolos runs list` shows the runs"
            ) from error
        if run is None or not is_description(run):
            raise RunError("run.json is damaged", where=str(path), hint="restore the folder from a copy, or remove it")
        if run["format"] > FORMAT:
            raise RunError("a newer karolos made this run folder", where=str(path), hint="update karolos")
        folder._run = run
        folder.id = run["id"]  # a folder that was renamed is still the same run
        return folder

    @staticmethod
    def check_writable(runs: str | Path) -> None:
        """Make the runs folder if it is not there, and write into it.

        Raises:
            MachineError: that is not possible.
        """
        root = Path(runs)
        with writing(root):
            root.mkdir(parents=True, exist_ok=True)
            probe = FileLock(root / ".write-test")
            probe.acquire()
            probe.release()
            probe.path.unlink(missing_ok=True)

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
        return self._object("resolved.json") or {}

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
        before = self._stored_state()
        steps = before.steps if steps is None else int(steps)
        seconds = before.seconds if seconds is None else float(seconds)
        self._write_state(RunState(state, steps, seconds, before.attempt, error, timestamp()))

    def next_attempt(self) -> int:
        """Count one more process that goes on with this run; returns its number, from 1."""
        before = self._stored_state()
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
        return self._read_tests()[0]

    def state(self) -> RunState:
        """The state now, `lost` included."""
        stored = self._stored_state()
        if stored.unfinished and not self.is_locked():
            stored = self._stored_state()  # it may have ended, and said so, between the two looks
            return stored.as_lost() if stored.unfinished else stored
        return stored

    def summary(self) -> RunSummary:
        """The run in one row, as the store keeps it."""
        return summarise(self.path.resolve(), self._run, self.state(), self.spec(), self._counts()[0], self.labels())

    def record(self) -> RunRecord:
        """All that the folder says, read once, and what is damaged or missing in it."""
        tests, problems = self._counts()
        spec = self.spec()
        for name in ("resolved.json", "state.json"):
            if self._object(name) is None:
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

    def _counts(self) -> tuple[tuple[TestCounts, ...], tuple[str, ...]]:
        """The tests by their counts, and what is damaged."""
        try:
            counted = count_lines((self.path / "tests.jsonl").read_bytes())
        except OSError:
            counted = None
        if counted is None:
            results, problems = self._read_tests()
            return tuple(TestCounts.of(result) for result in results), problems
        unique = {test.steps: test for test in counted}
        return tuple(unique[steps] for steps in sorted(unique)), ()

    def _read_tests(self) -> tuple[tuple[TestResult, ...], tuple[str, ...]]:
        rows, problems = read_lines(self.path / "tests.jsonl")
        decoded = [decode_test(row) for row in rows]
        unique = {result.steps: result for result in decoded if result is not None}
        odd = decoded.count(None)
        if odd:
            problems += (f"tests.jsonl: {odd} lines are no test results; left out",)
        return tuple(unique[steps] for steps in sorted(unique)), problems

    def _object(self, name: str) -> dict[str, Any] | None:
        try:
            return parse_object((self.path / name).read_bytes())
        except OSError:
            return None

    def _stored_state(self) -> RunState:
        return RunState.from_row(self._object("state.json") or {})

    def _write_state(self, state: RunState) -> None:
        write_json(self.path / "state.json", state.to_row())


def paths(runs: str | Path, pattern: str = "*") -> list[Path]:
    """The folders in a runs folder that are those of runs, sound or damaged, by name; other folders are passed over.

    Args:
        runs: the runs folder; one that is not there holds none.
        pattern: of the folders' names, as a shell's.
    """
    try:
        found = sorted(path for path in Path(runs).iterdir() if fnmatchcase(path.name, pattern))
    except FileNotFoundError:
        return []
    except OSError as error:
        raise MachineError(f"cannot be read ({error.strerror})", where=str(runs), hint="name a runs folder") from error
    return [path for path in found if os.path.isfile(path / "run.json")]


def scan(runs: str | Path, pattern: str = "*") -> Iterator[RunFolder | RunError]:
    """The run folders in a runs folder, by name; for a damaged one its error. Arguments as those of `paths`."""
    for path in paths(runs, pattern):
        try:
            yield RunFolder.open(path)
        except RunError as error:
            yield error
