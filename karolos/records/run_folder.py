"""RunFolder: one run's folder, made, locked, written and read; and the run folders in a runs folder."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from hashlib import sha256
from pathlib import Path
from time import monotonic
from typing import Any, TypeVar

from .. import system
from ..errors import MachineError, RunError, recorded, redact
from ..files import (
    UNFINISHED,
    FileLock,
    append_lines,
    copy_named,
    parse_object,
    read_lines,
    read_values,
    remove_leftovers,
    write_json,
    write_whole,
    writing,
)
from . import labels, provenance
from .decode import from_json, read_json
from .labels import Labels
from .results import FinalTest, TestCounts, TestResult, decode_final, decode_test, encode_final, encode_test
from .run_records import (
    FORMAT,
    SWEEPS,
    THRESHOLD,
    RunDescription,
    RunRecord,
    RunState,
    RunSummary,
    State,
    part_name,
    timestamp,
)

LOCK_SECONDS = 0.5
"""A reader that checks whether a run is alive holds the lock for an instant; the run waits this long for it."""
FINAL = "final.jsonl"
ROBOT = "robot"
"""Folder of the copies of an arm's file and its meshes, which a run of the robot `urdf` reads."""
DAMAGED_SPEC = "missing, damaged or changed"
_FOLDERS = 10_000
_GIVEN_NAME = re.compile(r"-s\d+-\d{8}-\d{6}(-\d+)?$")
_Test = TypeVar("_Test", TestResult, TestCounts)


class RunFolder:
    """One run's folder. Get one from `create` (new, locked) or `open`; use it in a `with` to free the lock at the end.

    Raises:
        MachineError: from every method that writes, if the disk is full or the folder cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.id = path.name
        self.checkpoints = path / "checkpoints"
        self.tensorboard = path / "tensorboard"
        self.progress = path / "progress.json"
        self.stop = path / "stop"
        self.launch = path / "launch.json"
        self._lock = FileLock(path / "lock")
        self._run: dict[str, Any] = {}
        self._locked_at: float | None = None
        """When this process locked the run (monotonic, s)."""
        self._earlier_seconds = 0.0
        """Of the processes before."""

    @classmethod
    def create(cls, runs: str | Path, name: str, seed: int) -> RunFolder:
        """Make `runs/<name>-s<seed>-<UTC date>-<time>` and lock it; `-2`, `-3` ... is added to a name that is taken.

        Raises:
            MachineError: the runs folder cannot be written.
        """
        now = datetime.now(UTC)
        path = _make_folder(Path(runs), f"{name}-s{seed}-{now:%Y%m%d-%H%M%S}")
        folder = cls(path)
        folder.lock()
        folder._run = {"format": FORMAT, "id": path.name, "name": name, "seed": seed, "created": timestamp(now)}
        return folder

    @classmethod
    def open(cls, path: str | Path) -> RunFolder:
        """An existing run's folder, to read it or, after `lock()`, to continue the run.

        Raises:
            RunError: it is not a run folder, or a newer karolos made it.
        """
        folder = cls(Path(path))
        folder._run = _read_description(folder.path)
        folder.id = folder._run["id"]  # a renamed folder is still the same run
        return folder

    @staticmethod
    def check_writable(runs: str | Path) -> None:
        """Make the runs folder if it does not exist, and write into it.

        Raises:
            MachineError: the folder cannot be written.
        """
        root = Path(runs)
        with writing(root):
            root.mkdir(parents=True, exist_ok=True)
            probe = FileLock(root / ".write-test")
            probe.acquire()
            probe.release()
            system.remove(probe.path, missing_ok=True)

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def lock(self, seconds: float = LOCK_SECONDS) -> None:
        """Lock the run for this process until `release` or the process's end.

        Raises:
            RunError: another process keeps it locked for this many seconds.
        """
        if not self._lock.acquire(seconds):
            raise RunError("another process is running it", where=self.id, hint="wait for it, or stop it first")
        self._locked_at, self._earlier_seconds = monotonic(), self._stored_state().total_seconds
        remove_leftovers(self.path, UNFINISHED)

    def release(self) -> None:
        """Unlock the run. Safe to call twice."""
        self._lock.release()

    def is_locked(self) -> bool:
        """Whether a living process has locked the run."""
        return self._lock.is_locked()

    def describe(
        self,
        resolved: Mapping[str, Any],
        *,
        experiment: str,
        text: str | None = None,
        source: Path | None = None,
        changed: Mapping[str, Any] | None = None,
        continued_from: Mapping[str, Any] | None = None,
        files: Mapping[str, str] | None = None,
    ) -> None:
        """Write what the run is made from. The folder counts as a run from here on, because run.json is written last.

        Args:
            resolved: the spec with every default filled in, as JSON values.
            experiment: hash of that spec without seeds and operational fields.
            text: the spec as its author wrote it.
            source: the folder whose git work tree is recorded; the current one by default.
            changed: the settings of the spec that differ from their defaults, as JSON values.
            continued_from: the run, and its steps, from whose end this one goes on.
            files: `Spec.files`.
        """
        unread: list[str] = []
        code = provenance.code(source or Path.cwd())
        if text is not None:
            write_whole(self.path / "spec.yaml", redact(text))
        if code and code.diff:
            write_whole(self.path / "code.diff", code.diff)
        write_json(self.path / "resolved.json", resolved)
        robot = resolved.get("robot") or {}
        if os.path.isfile(robot.get("file") or ""):
            copy_named(Path(robot["file"]), self.path / ROBOT)
        self._run |= {
            "experiment": experiment,
            "changed": changed,
            "resolved_sha256": sha256((self.path / "resolved.json").read_bytes()).hexdigest(),
            "versions": provenance.versions(),
            "sources": provenance.sources(provenance.packages(resolved), unread),
            "unread": unread,
            "files": files,
            "machine": provenance.kind_of_machine(),
            "command": provenance.command_line(),
            "git": {"commit": code.commit, "dirty": code.dirty, "untracked": list(code.untracked)} if code else None,
        }
        self._run |= {} if continued_from is None else {"continued_from": continued_from}
        self._write_state(RunState("created"))
        write_json(self.path / "run.json", recorded(self._run))

    def description(self) -> dict[str, Any]:
        """The content of run.json: id, experiment, name, seed, created, versions, command, git."""
        return dict(self._run)

    def spec(self) -> dict[str, Any]:
        """The resolved spec.

        Raises:
            RunError: its file is missing or damaged, or was changed after the run had begun.
        """
        spec = self.read_spec()
        if spec is None:
            raise RunError(f"resolved.json is {DAMAGED_SPEC}", where=self.id, hint="restore the folder from a copy")
        return spec

    def read_spec(self) -> dict[str, Any] | None:
        """The resolved spec; None if it cannot be trusted."""
        try:
            data = (self.path / "resolved.json").read_bytes()
        except OSError:
            return None
        made = self._run.get("resolved_sha256")
        spec = parse_object(data) if made in (None, sha256(data).hexdigest()) else None
        robot = (spec or {}).get("robot")
        if isinstance(robot, dict) and isinstance(file := robot.get("file"), str):
            copies = [one for one in (self.path / ROBOT).rglob("*") if one.name == re.split(r"[/\\]", file)[-1]]
            robot["file"] = str(copies[0].absolute()) if copies else file
        return spec

    def set_state(self, state: State, *, error: str | None = None, **amounts: Any) -> None:
        """Replace the state.

        Args:
            state: any but lost.
            error: why it failed, in one line.
            amounts: steps, seconds and updates of training so far; what is not given keeps its value.
        """
        self._write_state(replace(self._stored_state(), state=state, error=error and redact(error), **amounts))

    def set_progress(self, **amounts: Any) -> None:
        """Say how far a running run is: steps, seconds and updates. Does not wait for the disk."""
        self._write_state(replace(self._stored_state(), **amounts), durable=False)

    def next_attempt(self) -> int:
        """Count one more process that continues this run; returns its number, from 1."""
        before = self._stored_state()
        self._write_state(replace(before, state="created", attempt=before.attempt + 1, error=None))
        return before.attempt + 1

    def labels(self) -> Labels:
        """Tags and note."""
        return labels.read(self.path)

    def event(self, kind: str, **data: Any) -> None:
        """Append an event; `data` are JSON values."""
        append_lines(self.path / "events.jsonl", [{"time": timestamp(), "event": kind, **recorded(data)}])

    def events(self) -> tuple[dict[str, Any], ...]:
        """The events in order; `record().problems` names lines that cannot be read."""
        return read_lines(self.path / "events.jsonl").rows

    def add_test(self, result: TestResult) -> None:
        """Append a test's result; it is on the disk when this returns."""
        append_lines(self.path / "tests.jsonl", [encode_test(result)])

    def cut_tests(self, steps: int) -> None:
        """Remove the tests after this many steps: a run that does not resume bit for bit tests at other steps."""
        path = self.path / "tests.jsonl"
        if not path.exists():
            return
        with writing(path):
            lines = path.read_bytes().splitlines(keepends=True)
        kept = [line for line in lines if (test := _count_test(line)) is None or test.steps <= steps]
        if len(kept) < len(lines):
            write_whole(path, b"".join(kept).decode(errors="replace"))

    def tests(self) -> tuple[TestResult, ...]:
        """The tests in the order of their steps; of two at the same step the later written, as a resumed run makes.

        `record().problems` names lines that cannot be read.
        """
        return _by_steps(read_values(self.path / "tests.jsonl", decode_test, "test").rows)

    def write_final(self, final: FinalTest) -> None:
        """Write the final test, whole or not at all."""
        lines = (json.dumps(row, separators=(",", ":"), allow_nan=False) for row in encode_final(final))
        write_whole(self.path / FINAL, "".join(f"{line}\n" for line in lines))

    def final(self) -> FinalTest | None:
        """The final test; None before it, or if its file is damaged (`record().problems` says so)."""
        try:
            text = (self.path / FINAL).read_bytes()
        except OSError:
            return None
        return decode_final(text) if text else None

    def add_episodes(self, episodes: Iterable[Mapping[str, Any]]) -> None:
        """Append the records of training episodes, JSON values each."""
        append_lines(self.path / "episodes.jsonl", episodes)

    def episodes_bytes(self) -> int:
        """Size of episodes.jsonl, for `cut_episodes` when the run is resumed."""
        path = self.path / "episodes.jsonl"
        return path.stat().st_size if path.exists() else 0

    def cut_episodes(self, size: int) -> None:
        """Remove the training episodes after this many bytes: a resumed run plays them again."""
        if self.episodes_bytes() > size:
            with writing(self.path / "episodes.jsonl"):
                os.truncate(self.path / "episodes.jsonl", size)

    def state(self) -> RunState:
        """The state now, `lost` included."""
        return self._current(self._stored_state())

    def summary(self) -> RunSummary:
        """The run in one row, as the store keeps it."""
        return self.record().summary

    def record(self) -> RunRecord:
        """The content of the folder, and what is damaged or missing in it."""
        spec = self.read_spec()
        state = read_json(RunState, self.path / "state.json")
        now = self._current(state or RunState("running"))
        # After the state: a finished run has all its tests.
        tests, problems = read_values(self.path / "tests.jsonl", _count_test, "test")
        if spec is None:
            problems += (f"resolved.json: {DAMAGED_SPEC}",)
        if state is None:
            problems += ("state.json: missing or damaged",)
        if labels.is_damaged(self.path):
            problems += ("labels.json: damaged; tags and note cannot be read",)
        final = self.final()
        if final is None and (self.path / FINAL).exists():
            problems += (f"{FINAL}: damaged; left out",)
        problems += read_lines(self.path / "events.jsonl").problems
        counts = _by_steps(tests)
        summary = self._summarise(now, spec or {}, counts, final)
        return RunRecord(summary, spec or {}, counts, self._run.get("versions", {}), problems)

    def _summarise(
        self, state: RunState, spec: Mapping[str, Any], tests: Sequence[TestCounts], final: FinalTest | None
    ) -> RunSummary:
        last = TestCounts.of(final.last) if final else tests[-1] if tests else None
        best = TestCounts.of(final.best) if final and final.best else None
        solved: dict[str, Any] = {}
        for suffix, success in (("", "success_end"), ("_any", "success_any")):
            first = next((test for test in tests if (getattr(test, success) or 0) >= THRESHOLD), None)
            for name in ("steps", "seconds"):
                solved[f"{name}_to_95{suffix}"] = getattr(first, name, None)
        parts: dict[str, Any] = {kind: part_name(spec, kind) for kind in ("environment", "robot", "task", "agent")}
        same = ("state", "steps", "seconds", "attempt", "error", "updates", "total_seconds")
        counted = ("success_any", "success_end", "episodes", "mean_return")
        reported: dict[str, Any] = {name: getattr(last, name, None) for name in counted}
        reported["measures"] = last.measures if last else {}
        return RunSummary(
            run=self.id,
            **{name: self._run[name] for name in ("experiment", "seed", "name", "created")},
            **{name: getattr(state, name) for name in same},
            **parts,
            **vars(self.labels()),
            **reported,
            **solved,
            updated=state.updated or self._run["created"],
            folder=str(self.path.resolve()),
            final=final is not None,
            source=provenance.source_of_others(self._run.get("sources") or {}),
            best_steps=getattr(best, "steps", None),
            best_any=getattr(best, "success_any", None),
            best_end=getattr(best, "success_end", None),
            best_return=getattr(best, "mean_return", None),
        )

    def _current(self, stored: RunState) -> RunState:
        """The state now, given what state.json held just before."""
        if stored.unfinished and not self.is_locked():
            stored = self._stored_state()  # the run may have ended after the first read
            if stored.unfinished and (stored.state, stored.attempt) != ("created", 1):  # such a run waits for its start
                return replace(stored, state="lost")
        return stored

    def _stored_state(self) -> RunState:
        return read_json(RunState, self.path / "state.json") or RunState("running")

    def _write_state(self, state: RunState, *, durable: bool = True) -> None:
        if self._locked_at is not None:
            state = replace(state, total_seconds=self._earlier_seconds + monotonic() - self._locked_at)
        write_json(self.path / "state.json", asdict(replace(state, updated=timestamp())), durable=durable)


def _count_test(line: bytes) -> TestCounts | None:
    """The counts of a test's line. Lines of version 0.1 have none, so their episodes are counted."""
    if b'"successes_end"' in line:
        return from_json(TestCounts, line)
    result = decode_test(line)
    return None if result is None else TestCounts.of(result)


def _by_steps(tests: Iterable[_Test]) -> tuple[_Test, ...]:
    """Tests in the order of their steps, of several at the same step the last."""
    unique = {test.steps: test for test in tests}
    return tuple(unique[steps] for steps in sorted(unique))


def paths(runs: str | Path, pattern: str = "*", description: str = "run.json") -> list[Path]:
    """The run folders in a runs folder, damaged ones included, by name.

    Args:
        runs: the runs folder; the list is empty if it does not exist.
        pattern: of the folders' names, as in a shell.
        description: the file that makes a folder one of them.
    """
    try:
        found = sorted(path for path in Path(runs).iterdir() if fnmatchcase(path.name, pattern))
    except FileNotFoundError:
        return []
    except OSError as error:
        raise MachineError(f"cannot be read ({error.strerror})", where=str(runs), hint="name a runs folder") from error
    return [path for path in found if os.path.isfile(path / description)]


def scan(runs: str | Path, pattern: str = "*") -> Iterator[RunFolder | RunError]:
    """The run folders in a runs folder, by name; for a damaged one its error. Arguments as those of `paths`."""
    for path in paths(runs, pattern):
        try:
            yield RunFolder.open(path)
        except RunError as error:
            yield error


def renamed(runs: str | Path) -> Iterator[RunFolder]:
    """The run folders that have lost the name they were given, by name. They are still the same runs."""
    for path in paths(runs):
        if _GIVEN_NAME.search(path.name) is None:
            with suppress(RunError):  # a damaged one does not say whose it is
                yield RunFolder.open(path)


def remove_lost_leftovers(runs: str | Path, pattern: str = "*") -> None:
    """Remove files that killed processes did not finish from run folders that no process has locked.

    Arguments as those of `paths`.
    """
    for path in paths(runs, pattern):
        if not FileLock(path / "lock").is_locked():
            remove_leftovers(path, UNFINISHED)


def _make_folder(runs: Path, stem: str) -> Path:
    with writing(runs):
        runs.mkdir(parents=True, exist_ok=True)
        for attempt in range(1, _FOLDERS):
            path = runs / (stem if attempt == 1 else f"{stem}-{attempt}")
            try:
                path.mkdir()  # succeeds in one process only, however many try
            except FileExistsError:
                continue
            return path
    raise MachineError(f"{stem} is taken", where=str(runs))


def _read_description(path: Path) -> Any:
    """The content of run.json. Raises RunError if it is not a run folder, or a newer karolos made it."""
    try:
        run = from_json(RunDescription, (path / "run.json").read_bytes())
    except OSError as error:
        raise RunError(
            f"this is not a run folder ({error.strerror})",
            where=str(path),
            hint="`karolos runs list` shows the runs, `karolos db reindex` forgets those whose folders are gone",
        ) from error
    if run is None or run["id"] == SWEEPS:
        raise RunError("run.json is damaged", where=str(path), hint="restore the folder from a copy, or remove it")
    if run["format"] > FORMAT:
        raise RunError("a newer karolos made this run folder", where=str(path), hint="update karolos")
    return run
