"""Runs specs with their seeds through a launcher, and follows the runs in their folders."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from ..core.launcher import Ended, Launcher
from ..errors import StoreError
from ..files import new_lines, read_object, write_json, write_whole
from ..launchers.local import Local
from ..records import RunFolder, provenance
from ..records.decode import from_json
from ..records.results import TestResult, decode_test
from ..records.run_records import UNFINISHED, RunSummary
from ..registry import load
from ..spec import Spec
from .events import (
    Listener,
    RunAdvanced,
    RunBusy,
    RunEnded,
    RunEvent,
    RunFinalTested,
    RunLaunched,
    RunStarted,
    RunTested,
    RunWarned,
)
from .resume import find_run
from .run_index import RunIndex
from .signals import StopRequest

Existing = Literal["ignore", "skip", "resume"]


@dataclass(eq=False)
class Job:
    """A spec with several seeds, and the results of its runs.

    Args:
        spec: with its seeds.
        together: whether the failure of one run stops the others.
        known: seed -> finished run that counts for it, whatever its name.
    """

    spec: Spec
    together: bool = False
    known: Mapping[int, RunFolder] = field(default_factory=dict)
    tests: dict[int, dict[int, TestResult]] = field(default_factory=dict)
    """Seed -> steps -> test."""
    steps: dict[int, int] = field(default_factory=dict)
    """Seed -> environment steps of its run."""
    finals: dict[int, TestResult] = field(default_factory=dict)
    """Seed -> the policy `last` in the final test, for runs that have one."""
    summaries: dict[int, RunSummary] = field(default_factory=dict)
    """Seed -> its run, when it has ended."""
    error: str | None = None
    """The error of the first run that failed."""
    halted: str | None = None
    """Why its runs were stopped."""
    deaths: dict[int, int] = field(default_factory=dict)
    """Seed -> number of processes that died."""

    @property
    def finished(self) -> bool:
        """Whether every run is finished."""
        states = [summary.state for summary in self.summaries.values()]
        return states == ["finished"] * len(self.spec.seeds)

    @property
    def fraction(self) -> float:
        """Fraction of the environment steps of all runs that are taken."""
        return sum(self.steps.values()) / (self.spec.training.steps * len(self.spec.seeds))

    def read_tests(self, seed: int, folder: RunFolder) -> None:
        """Read the tests and the final test in a run's folder."""
        self.tests[seed] = {test.steps: test for test in folder.tests()}
        if (final := folder.final()) is not None:
            self.finals[seed] = final.last

    def record(self, summary: RunSummary) -> None:
        """Record the end of a run."""
        self.summaries[summary.seed] = summary
        self.steps[summary.seed] = self.spec.training.steps

    def results(self) -> dict[int, list[TestResult]]:
        """Seed -> its tests in order; seeds in the spec's order."""
        return {seed: [test for _, test in sorted(self.tests.get(seed, {}).items())] for seed in self.spec.seeds}


class Feed:
    """The source of a driver's jobs, which hears what happens to them. This one has a list of jobs."""

    def __init__(self, *jobs: Job) -> None:
        self._jobs = deque(jobs)

    def next(self) -> Job | None:
        """The next job to start; None if there is none at the moment."""
        return self._jobs.popleft() if self._jobs else None

    def heard(self, job: Job, event: RunEvent) -> str | None:  # noqa: ARG002
        """Called with each event of a run. Returns a reason to stop the job's runs, or None."""
        return None

    def ended(self, job: Job) -> None:
        """Called when no run of the job is active."""


def find_existing(runs: Path, spec: Spec, seed: int, existing: Existing) -> RunFolder | None:
    """The run to use instead of a new one: a finished one, or one to resume."""
    found = None if existing == "ignore" else find_run(runs, spec.name, spec.hash(), seed)
    return found if found and (existing == "resume" or found.state().state == "finished") else None


def create(runs: Path, spec: Spec, seed: int, text: str | None) -> RunFolder:
    """A new run's folder, locked."""
    folder = RunFolder.create(runs, spec.name, seed)
    folder.describe(spec.dump(), experiment=spec.hash(), text=text)
    return folder


def make_launcher(spec: Spec, jobs: int | None) -> Launcher:
    """The spec's launcher, for so many runs at the same time."""
    if spec.launcher is None:
        return Local(Local.Settings(), jobs)
    launcher: Launcher = load("launchers", spec.launcher.name)(spec.launcher.settings, jobs)
    return launcher


class Driver:
    """Runs jobs through a launcher. It alone writes the results database.

    Args:
        launcher: executes the runs.
        runs: folder of the run folders.
        url: SQLAlchemy URL of the results database.
        listener: is called with every RunEvent.
        existing: what to do with existing runs, as for `Experiment.run`.
        text: the spec as its author wrote it.
        retries: how many times a run is resumed after its process died.
    """

    def __init__(
        self,
        launcher: Launcher,
        runs: Path,
        url: str,
        listener: Listener,
        *,
        existing: Existing,
        text: str | None,
        retries: int = 0,
    ) -> None:
        self._launcher, self._runs, self._url, self._listener = launcher, runs, url, listener
        self._existing, self._text, self._retries = existing, text, retries
        self._waiting: deque[tuple[Job, int, RunFolder | None]] = deque()
        self._active: dict[Path, Follower] = {}

    def run(self, feed: Feed, stop: StopRequest) -> None:
        """Run the feed's jobs until it has no more. After a stop request the runs end with a checkpoint."""
        try:
            self._run(feed, stop)
        finally:
            for active in self._active.values():
                active.index.close()

    def _run(self, feed: Feed, stop: StopRequest) -> None:
        jobs: list[Job] = []
        while True:
            while not stop.requested and (job := feed.next()) is not None:
                jobs.append(job)
                self._enqueue(job)
            if not jobs:
                return
            if stop.requested:
                for job in jobs:
                    self._halt(job, stop.reason or "stopped")
            for _ in range(min(self._launcher.room(len(self._waiting)), len(self._waiting))):
                self._start(*self._waiting.popleft())
            if self._waiting or self._active:
                ended = self._launcher.wait(self._launcher.poll_seconds)
                for active in self._active.values():
                    self._follow(active, feed)
                if ended is not None:
                    self._end(ended, feed)
            for job in [job for job in jobs if not self._is_active(job)]:
                jobs.remove(job)
                feed.ended(job)

    def _enqueue(self, job: Job) -> None:
        for seed in job.spec.seeds:
            found = job.known.get(seed) or find_existing(self._runs, job.spec, seed, self._existing)
            if found is not None and found.state().state == "finished":
                job.read_tests(seed, found)
                job.record(found.summary())
            else:
                self._waiting.append((job, seed, found))

    def _is_active(self, job: Job) -> bool:
        return any(one.job is job for one in self._active.values()) or any(one is job for one, *_ in self._waiting)

    def _start(self, job: Job, seed: int, folder: RunFolder | None) -> None:
        folder = folder or create(self._runs, job.spec, seed, self._text)
        folder.release()
        folder.stop.unlink(missing_ok=True)  # of an earlier process
        write_json(folder.launch, provenance.software())
        job.read_tests(seed, folder)
        active = Follower(job, seed, folder, RunIndex(self._url, folder))
        self._active[folder.path.resolve()] = active
        self._update_index(active)  # on a cluster it may wait for long
        self._launcher.start(folder.path.resolve())
        self._listener(RunLaunched(folder.id))

    def _follow(self, active: Follower, feed: Feed) -> None:
        for event in active.events():
            if isinstance(event, RunTested):
                active.job.tests[active.seed][event.result.steps] = event.result
                self._update_index(active, event.result)
            elif isinstance(event, RunAdvanced):
                active.job.steps[active.seed] = min(event.steps, active.job.spec.training.steps)
            elif isinstance(event, RunFinalTested):
                active.job.finals[active.seed] = event.final.last
            elif isinstance(event, RunStarted):
                self._update_index(active)
            self._tell(active.job, event, feed)

    def _tell(self, job: Job, event: RunEvent, feed: Feed) -> None:
        self._listener(event)
        reason = feed.heard(job, event)
        if reason is not None:
            self._halt(job, reason)

    def _update_index(self, active: Follower, result: TestResult | None = None) -> None:
        try:
            active.index.update()
        except StoreError as error:
            what = "its folder is complete" if result is None else "the test is in the run folder"
            self._listener(RunWarned(active.folder.id, f"{error} (the run continues; {what})"))

    def _halt(self, job: Job, reason: str) -> None:
        """Stop the job's runs: their processes read the reason in the file `stop`."""
        if job.halted:
            return
        job.halted = reason
        self._waiting = deque(one for one in self._waiting if one[0] is not job)
        for active in self._active.values():
            if active.job is job:
                write_whole(active.folder.stop, reason)

    def _end(self, ended: Ended, feed: Feed) -> None:
        """Record the end of a run, or resume it if its process died."""
        active = self._active[ended.folder]
        self._follow(active, feed)
        del self._active[ended.folder]
        job, seed, folder = active.job, active.seed, active.folder
        folder.stop.unlink(missing_ok=True)
        summary, problem = folder.summary(), ended.problem
        has_begun = folder.state() != active.before
        if (refusal := (read_object(folder.launch) or {}).get("problem")) is not None:
            problem = str(refusal)  # another process would refuse as well
        elif ended.died and (summary.state not in (*UNFINISHED, "lost") if has_begun else job.halted):
            problem = None  # the run has come to its end
        elif ended.died and not job.halted:
            job.deaths[seed] = job.deaths.get(seed, 0) + 1
            if job.deaths[seed] <= self._retries:
                active.index.close()
                self._waiting.appendleft((job, seed, folder))
                return
            problem = f"{problem}, {job.deaths[seed]} times" if self._retries else problem
        error, traceback = active.failure
        if problem is not None and summary.state != "finished":
            state = "lost" if summary.state in UNFINISHED else summary.state
            summary, error, traceback = replace(summary, state=state, error=problem), problem, None
        else:
            self._update_index(active)
        active.index.close()
        job.record(summary)
        self._tell(job, RunEnded(summary.run, summary.state, error, traceback), feed)
        if summary.error is not None and not job.halted:
            job.error = job.error or summary.error
            if job.together:
                self._halt(job, "another run of this trial failed")


class Follower:
    """A run that a launcher executes. Turns what its process writes into the folder into events, from now on."""

    def __init__(self, job: Job, seed: int, folder: RunFolder, index: RunIndex) -> None:
        self.job, self.seed, self.folder, self.index = job, seed, folder, index
        self._ends = {name: new_lines(folder.path / name, 0)[1] for name in ("events.jsonl", "tests.jsonl")}
        self._progress = read_object(folder.progress) or {}
        self.before = folder.state()
        """The state before its process begins."""
        self.failure: tuple[str | None, str | None] = (None, None)
        """The error of the run and its traceback, if it failed."""

    def events(self) -> Iterator[RunEvent]:
        """What has happened since the last call."""
        run = self.folder.id
        earlier, self._progress = self._progress, read_object(self.folder.progress) or {}
        happened = self._new("events.jsonl")
        tests = [decode_test(row) for row in self._new("tests.jsonl")]  # the tests before these events are written
        if any(row["event"] in ("started", "resumed") for row in happened):
            yield RunStarted(run, self.seed, self.job.spec.training.steps, str(self.folder.path))
        for name, row in self._progress.items():
            event = from_json(RunAdvanced, row) if name == "RunAdvanced" else from_json(RunBusy, row)
            if event is not None and row != earlier.get(name):
                yield event
        yield from (RunTested(run, result) for result in tests if result is not None)
        for row in happened:
            if row["event"] == "warning":
                yield RunWarned(run, f"{row['error']} ({row['consequence']})")
            elif row["event"] == "final_test" and (final := self.folder.final()) is not None:
                yield RunFinalTested(run, final)
            elif row["event"] == "failed":
                self.failure = row["error"], row["traceback"]

    def _new(self, name: str) -> list[dict[str, Any]]:
        rows, self._ends[name] = new_lines(self.folder.path / name, self._ends[name])
        return rows
