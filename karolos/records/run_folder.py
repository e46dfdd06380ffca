"""RunFolder: creates, locks, writes and reads one run's folder. Also lists the run folders in a runs folder."""

from __future__ import annotations

import json
import os
import platform
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, replace
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from hashlib import sha256
from pathlib import Path
from time import monotonic
from typing import Any

from .. import system
from ..errors import MachineError, RunError, recorded, redact
from ..system.files import (
    UNFINISHED,
    FileLock,
    Lines,
    append_lines,
    copy_named,
    locked,
    new_lines,
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
from .evaluation import Evaluation, decode, decode_counts, decode_final
from .labels import Labels
from .run_records import (
    FORMAT,
    SWEEPS,
    THRESHOLD,
    RunDescription,
    RunRecord,
    RunState,
    RunSummary,
    StateName,
    part_name,
    timestamp,
)

LOCK_SECONDS = 0.5
"""Time that a run waits for its lock. A reader that checks whether the run is alive holds it for an instant."""
TESTS, FINAL, TRANSFERS = "tests.jsonl", "final.jsonl", "transfers.jsonl"
LAUNCH, STOP = "launch.json", "stop"
"""Files in an executed folder. launch.json: software, end or refusal of the process. stop: the reason to stop."""
ROBOT = "robot"
"""Folder of the copies of an arm's file and its meshes, which a run of the robot `urdf` reads."""
STAGE_EPISODES, EPISODE_BYTES = 500, 1000
"""Number of training episodes for the success by stage, and the largest usual length of an episode's line."""
DAMAGED_SPEC = "missing, damaged or changed"
_FOLDERS = 10_000
_GIVEN_NAME = re.compile(r"-s\d+-\d{8}-\d{6}(-\d+)?$")


class RunFolder:
    """One run's folder. Get one from `create` (new, locked) or `open`; use it in a `with` to free the lock at the end.

    Raises MachineError from every method that writes, if the disk is full or the folder cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.id = path.name
        self.checkpoints = path / "checkpoints"
        self.tensorboard = path / "tensorboard"
        self.progress = path / "progress.json"
        self.stop = path / STOP
        self.launch = path / LAUNCH
        self._lock = FileLock(path / "lock")
        self._run: dict[str, Any] = {}
        self._locked_at: float | None = None
        """Time at which this process locked the run (monotonic, s)."""
        self._earlier_seconds = 0.0
        """Seconds that earlier processes worked on the run."""
        self._tests: Lines[Evaluation] | None = None
        """Result of `_read_tests`. Only the process that locked the run writes tests; it reads them once."""

    @classmethod
    def create(cls, runs: str | Path, name: str, seed: int) -> RunFolder:
        """Make `runs/<name>-s<seed>-<UTC date>-<time>` and lock it; `-2`, `-3` ... is added to a name that is taken."""
        now = datetime.now(UTC)
        root, stem = Path(runs), f"{name}-s{seed}-{now:%Y%m%d-%H%M%S}"
        with writing(root):
            root.mkdir(parents=True, exist_ok=True)
            for attempt in range(1, _FOLDERS):
                path = root / (stem if attempt == 1 else f"{stem}-{attempt}")
                with suppress(FileExistsError):
                    path.mkdir()  # succeeds in only one process
                    break
            else:
                raise MachineError(f"the name {stem} is taken", where=str(runs))
        folder = cls(path)
        folder.lock()
        folder._run = {"format": FORMAT, "id": path.name, "name": name, "seed": seed, "created": timestamp(now)}
        return folder

    @classmethod
    def open(cls, path: str | Path) -> RunFolder:
        """An existing run's folder, to read it or, after `lock()`, to continue the run.

        Raises RunError if it is not a run folder, or a newer karolos made it.
        """
        folder = cls(Path(path))
        try:
            run: Any = from_json(RunDescription, (folder.path / "run.json").read_bytes())
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
        folder._run, folder.id = run, run["id"]  # a renamed folder is still the same run
        return folder

    @staticmethod
    def check_writable(runs: str | Path) -> None:
        """Make the runs folder if it does not exist, and try to write into it."""
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
        """Lock the run for this process until it ends or calls `release`.

        Raises RunError if another process keeps it locked for this many seconds.
        """
        if not self._lock.acquire(seconds):
            raise RunError("another process is running it", where=self.id, hint="wait for it, or stop it first")
        self._locked_at, self._earlier_seconds = monotonic(), self._stored_state().total_seconds
        self._tests = None
        remove_leftovers(self.path, UNFINISHED)

    def release(self) -> None:
        """Unlock the run. Safe to call twice."""
        self._lock.release()

    @contextmanager
    def removed_on_error(self) -> Iterator[None]:
        """Remove the folder if the block, which fills it, raises an error: without run.json nobody would find it."""
        with ExitStack() as undo:
            undo.callback(system.remove_tree, self.path, ignore_errors=True)
            undo.callback(self.release)
            yield
            undo.pop_all()

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
        """Write the spec and provenance of the run. The folder counts as a run from here on: run.json is written last.

        Args:
            resolved: the spec with every default filled in, as JSON values.
            experiment: hash of that spec without seeds and operational fields.
            text: the spec as its author wrote it.
            source: the folder whose git work tree is recorded; the current one by default.
            changed: the settings of the spec that differ from their defaults, as JSON values.
            continued_from: the run that this one continues, and its number of steps.
            files: `Spec.files`.
        """
        unread: list[str] = []
        git, diff = provenance.code(source or Path.cwd()) or (None, "")
        if text is not None:
            write_whole(self.path / "spec.yaml", redact(text))
        if diff:
            write_whole(self.path / "code.diff", diff)
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
            "machine": f"{platform.system()} {platform.machine()}",  # numbers may depend on it
            "command": provenance.command_line(),
            "git": git,
        }
        self._run |= {} if continued_from is None else {"continued_from": continued_from}
        self._write_state(RunState("created"))
        write_json(self.path / "run.json", recorded(self._run))

    def description(self) -> dict[str, Any]:
        """The content of run.json: id, experiment, name, seed, created, versions, command, git."""
        return dict(self._run)

    def spec(self) -> dict[str, Any]:
        """The resolved spec. Raises RunError if its file is missing or damaged, or was changed after the start."""
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

    def set_state(self, state: StateName, *, error: str | None = None, **amounts: Any) -> None:
        """Replace the state (any except lost) and the error: why it failed, in one line.

        `amounts` are steps, seconds and updates of training so far; missing ones keep their values.
        """
        self._write_state(replace(self._stored_state(), state=state, error=error and redact(error), **amounts))

    def set_progress(self, **amounts: Any) -> None:
        """Write the progress of a running run: steps, seconds and updates. Does not wait for the disk."""
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

    def add_test(self, test: Evaluation) -> None:
        """Append a test during training; it is on the disk when this returns."""
        append_lines(self.path / TESTS, [test.encode()])
        if self._tests is not None:
            self._tests = Lines((*self._tests.rows, test), self._tests.problems)

    def cut_tests(self, steps: int) -> None:
        """Remove the tests after these steps: a run that does not resume bit for bit has tests at other steps."""
        path, self._tests = self.path / TESTS, None
        if not path.exists():
            return
        with writing(path):
            lines = path.read_bytes().splitlines(keepends=True)
        kept = [line for line in lines if (test := decode(line)) is None or test.steps <= steps]
        if len(kept) < len(lines):
            write_whole(path, b"".join(kept).decode(errors="replace"))

    def tests(self) -> tuple[Evaluation, ...]:
        """The tests during training in the order of their steps, episode by episode.

        If two have the same step, as after a resume, the later one counts. `record().problems` names lines
        that cannot be read.
        """
        return _by_steps(self._read_tests().rows)

    def _read_tests(self) -> Lines[Evaluation]:
        if self._tests is not None and self._lock.held:
            return self._tests
        self._tests = read_values(self.path / TESTS, decode, "test")
        return self._tests

    def write_final(self, final: Mapping[str, Evaluation]) -> None:
        """Write the final test of each checkpoint, `last` first: whole or not at all."""
        lines = (json.dumps(one.encode(), separators=(",", ":"), allow_nan=False) for one in final.values())
        write_whole(self.path / FINAL, "".join(f"{line}\n" for line in lines))

    def final(self) -> dict[str, Evaluation]:
        """The final test by checkpoint, `last` and `best`, on held-out episodes.

        `best` is missing if its checkpoint could not be written or read. Empty before the final test, or if its file is
        damaged (`record().problems` says so).
        """
        try:
            return decode_final((self.path / FINAL).read_bytes())
        except OSError:
            return {}

    def add_transfer(self, transfer: Evaluation) -> None:
        """Append a test under changed settings, which any process may do at any time; it is on the disk on return."""
        with locked(self.path / "transfers.lock"):
            append_lines(self.path / TRANSFERS, [transfer.encode()])

    def transfers(self) -> Lines[Evaluation]:
        """The tests of its policies under changed settings in the order of the file, and one line per problem."""
        return read_values(self.path / TRANSFERS, decode, "test")

    def add_episodes(self, episodes: Iterable[Mapping[str, Any]]) -> None:
        """Append the records of training episodes, JSON values each."""
        append_lines(self.path / "episodes.jsonl", episodes)

    def stages(self, prefix: str, episodes: int = STAGE_EPISODES) -> dict[str, tuple[int, int]]:
        """Stage -> number of the last training episodes that began in it, and of successes among them.

        prefix: beginning of the names of stages' parameters (`core.environment.STAGE`, which imports NumPy).
        "start" are those that began as tests do. The easiest comes first. Empty where none begins further on.
        """
        found: dict[str, tuple[int, int]] = {}
        start = self.episodes_bytes() - episodes * EPISODE_BYTES
        for row in new_lines(self.path / "episodes.jsonl", max(start, 0))[0][-episodes:]:
            chances = {name: drawn for name, drawn in row.get("parameters", {}).items() if name.startswith(prefix)}
            if not chances or not {0.0, 1.0}.issuperset(chances.values()):
                return {}  # version 0.2 recorded the probabilities
            stage = next((name.removeprefix(prefix) for name, drawn in chances.items() if drawn), "start")
            played, succeeded = found.get(stage, (0, 0))
            found[stage] = played + 1, succeeded + row["end"]
        return dict(sorted(found.items(), key=lambda one: -one[1][1] / one[1][0]))

    def episodes_bytes(self) -> int:
        """Size of episodes.jsonl, for `cut_episodes` when the run is resumed."""
        path = self.path / "episodes.jsonl"
        return path.stat().st_size if path.exists() else 0

    def cut_episodes(self, size: int) -> None:
        """Remove the training episodes after these bytes: a resumed run plays them again."""
        if self.episodes_bytes() > size:
            with writing(self.path / "episodes.jsonl"):
                os.truncate(self.path / "episodes.jsonl", size)

    def state(self) -> RunState:
        """The current state, which may be `lost`."""
        return self._current(self._stored_state())

    def summary(self) -> RunSummary:
        """The run in one row, as the store keeps it."""
        return self.record().summary

    def record(self) -> RunRecord:
        """The content of the folder, and its damaged or missing files."""
        spec = self.read_spec()
        state = read_json(RunState, self.path / "state.json")
        now = self._current(state or RunState("running"))
        if self._lock.held:
            rows, problems = self._read_tests()
            tests = _by_steps(test.counts for test in rows)
        else:  # after the state: a finished run has all its tests
            rows, problems = read_values(self.path / TESTS, decode_counts, "test")
            tests = _by_steps(rows)
        if spec is None:
            problems += (f"resolved.json: {DAMAGED_SPEC}",)
        if state is None:
            problems += ("state.json: missing or damaged",)
        if labels.is_damaged(self.path):
            problems += ("labels.json: damaged; tags and note cannot be read",)
        final = self.final()
        if not final and (self.path / FINAL).exists():
            problems += (f"{FINAL}: damaged; left out",)
        problems += read_lines(self.path / "events.jsonl").problems
        spec = spec or {}
        reported, best, found = final.get("last", tests[-1] if tests else None), final.get("best"), self.labels()
        solved = next((test for test in tests if (test.success_end or 0) >= THRESHOLD), None)
        solved_any = next((test for test in tests if (test.success_any or 0) >= THRESHOLD), None)
        summary = RunSummary(
            run=self.id,
            experiment=self._run["experiment"],
            seed=self._run["seed"],
            state=now.state,
            steps=now.steps,
            seconds=now.seconds,
            success_any=reported and reported.success_any,
            success_end=reported and reported.success_end,
            steps_to_95=solved and solved.steps,
            seconds_to_95=solved and solved.seconds,
            name=self._run["name"],
            episodes=reported and reported.episodes,
            environment=part_name(spec, "environment"),
            robot=part_name(spec, "robot"),
            task=part_name(spec, "task"),
            agent=part_name(spec, "agent"),
            attempt=now.attempt,
            error=now.error,
            created=self._run["created"],
            updated=now.updated or self._run["created"],
            folder=str(self.path.resolve()),
            tags=found.tags,
            note=found.note,
            updates=now.updates,
            final=bool(final),
            best_steps=best and best.steps,
            best_any=best and best.success_any,
            best_end=best and best.success_end,
            steps_to_95_any=solved_any and solved_any.steps,
            seconds_to_95_any=solved_any and solved_any.seconds,
            total_seconds=now.total_seconds,
            mean_return=reported and reported.mean_return,
            best_return=best and best.mean_return,
            measures=reported.counts.measures if reported else {},
            source=provenance.source_of_others(self._run.get("sources") or {}),
        )
        git = self._run.get("git") or {}
        commit = f"{git['commit'][:8]}{'+' if git.get('dirty') else ''}" if git.get("commit") else None
        return RunRecord(summary, spec, tests, self._run.get("versions", {}), commit, problems)

    def _current(self, stored: RunState) -> RunState:
        """The current state, given a state.json that was read just before."""
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


def _by_steps(tests: Iterable[Evaluation]) -> tuple[Evaluation, ...]:
    """Tests in the order of their steps; for each step the last one."""
    unique = {test.steps: test for test in tests}
    return tuple(unique[steps] for steps in sorted(unique))


def paths(runs: str | Path, pattern: str = "*", description: str = "run.json") -> list[Path]:
    """The run folders in a runs folder, damaged ones included, by name; none if it does not exist.

    `pattern` is that of the folders' names, as in a shell, `description` the file that marks a run folder.
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
    """The renamed run folders, by name. They are still the same runs."""
    for path in paths(runs):
        if _GIVEN_NAME.search(path.name) is None:
            with suppress(RunError):  # a damaged one does not say its run
                yield RunFolder.open(path)


def remove_lost_leftovers(runs: str | Path, pattern: str = "*") -> None:
    """Remove incomplete files of killed processes from run folders that no process has locked.

    Arguments as those of `paths`.
    """
    for path in paths(runs, pattern):
        if not FileLock(path / "lock").is_locked():
            remove_leftovers(path, UNFINISHED)
