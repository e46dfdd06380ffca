"""A pool of worker processes that run the jobs of a sweep, so that each process imports libraries once.

A worker holds a lock file while it runs, so that a sweep whose parent was killed is not started again beside orphans.
When the parent has ended, the worker writes a checkpoint and exits.
"""

from __future__ import annotations

import signal
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from ..errors import KarolosError, MachineError
from ..experiment.events import RunAdvanced, RunEvent, RunStarted, RunTested, RunWarned
from ..experiment.experiment import SeedRunner
from ..experiment.jobs import POLL_SECONDS, exit_cause, start_process
from ..experiment.resume import find_run
from ..experiment.signals import StopRequest, stop_on_signals
from ..files import FileLock
from ..records import RunFolder
from ..records.results import TestResult
from ..records.run_records import RunSummary
from ..spec import Spec, Sweep, spec_from_dict
from ..training.assembly import check_parts
from .events import SweepListener, TrialAdvanced
from .objectives import measure

_LOCK_SECONDS = 10.0
MAX_DEATHS = 2
"""Processes that may die during a run until it fails. The second process resumes the run from its checkpoint."""


@dataclass(eq=False)
class Job:
    """A spec with several seeds, and the results of its runs."""

    spec: Spec
    tests: dict[int, dict[int, TestResult]] = field(default_factory=dict)
    """Seed -> steps -> test."""
    finals: dict[int, TestResult] = field(default_factory=dict)
    """Seed -> the policy `last` in the final test, for runs that have one."""
    summaries: dict[int, RunSummary] = field(default_factory=dict)
    error: str | None = None
    """The error of the first run that failed."""
    halted: str | None = None
    """Why its runs were stopped."""
    deaths: dict[int, int] = field(default_factory=dict)
    """Seed -> number of processes that died."""
    steps: dict[int, int] = field(default_factory=dict)
    """Seed -> environment steps of its run."""

    @property
    def finished(self) -> bool:
        """Whether every run is finished."""
        return len(self.summaries) == len(self.spec.seeds) and all(
            summary.state == "finished" for summary in self.summaries.values()
        )

    @property
    def fraction(self) -> float:
        """Fraction of the environment steps of all runs that are taken."""
        return sum(self.steps.values()) / (self.spec.training.steps * len(self.spec.seeds))

    def results(self) -> dict[int, list[TestResult]]:
        """Seed -> its tests in order; seeds in the spec's order."""
        return {seed: [test for _, test in sorted(self.tests.get(seed, {}).items())] for seed in self.spec.seeds}

    def measure(self, sweep: Sweep) -> tuple[float, ...]:
        """The sweep's objectives of the finished runs."""
        results, steps = self.results(), self.spec.training.steps
        return tuple(measure(name, results, steps, self.finals) for name in sweep.objectives)

    def record(self, summary: RunSummary) -> None:
        """Record the end of a run."""
        self.summaries[summary.seed] = summary
        self.steps[summary.seed] = self.spec.training.steps
        self.read_tests(summary.seed, summary.folder)
        final = RunFolder.open(summary.folder).final()
        if final is not None:
            self.finals[summary.seed] = final.last

    def read_tests(self, seed: int, folder: str) -> None:
        """Read the tests in a run's folder, also of a resumed run."""
        tests = RunFolder.open(folder).tests()
        self.tests.setdefault(seed, {}).update({test.steps: test for test in tests})


class Feed(ABC):
    """The source of a pool's jobs and the receiver of their results."""

    @abstractmethod
    def next(self) -> Job | None:
        """The next job to start; None if there is none at the moment."""

    def tested(self, job: Job) -> str | None:  # noqa: ARG002
        """Called after each test of a run. Returns a reason to stop the job's runs, or None."""
        return None

    def ended(self, job: Job) -> None:  # noqa: B027  (optional)
        """Called when no run of the job is active."""


@dataclass(frozen=True)
class Begin:
    """To the worker: execute this run."""

    seed: int
    spec: dict[str, Any]


@dataclass(frozen=True)
class Halt:
    """To the worker: stop the run with a checkpoint."""

    word: str


@dataclass(frozen=True)
class Ready:
    """From the worker: it holds its lock and is idle."""


@dataclass(frozen=True)
class Refused:
    """From the worker: the run could not be started."""

    error: str


@dataclass
class _Worker:
    process: Any
    pipe: Connection
    lock: Path
    ready: bool = False
    job: Job | None = None
    seed: int = 0


class RunPool:
    """Worker processes that run jobs; a context manager.

    Args:
        size: largest number of processes.
        locks: folder of their lock files.
        runner: runs one seed; the worker sets its spec.
        listener: called with the progress of jobs and the warnings of runs.
    """

    def __init__(self, size: int, locks: Path, runner: SeedRunner, listener: SweepListener) -> None:
        self._size = size
        self._locks = locks
        self._runner = runner
        self._listener = listener
        self._workers: list[_Worker] = []
        self._waiting: deque[tuple[Job, int]] = deque()

    def __enter__(self) -> RunPool:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.pipe.close()  # which makes it exit
            if not worker.ready:  # it imports libraries for seconds, and has nothing to lose
                worker.process.terminate()
        for worker in self._workers:
            worker.process.join()

    def run(self, feed: Feed, stop: StopRequest) -> None:
        """Run the feed's jobs until it has no more. After a stop request the runs end with a checkpoint."""
        active: list[Job] = []
        while True:
            while not stop.requested and (job := feed.next()) is not None:
                active.append(job)
                self._waiting.extend((job, seed) for seed in job.spec.seeds if not self._is_finished(job, seed))
            if not active:
                return
            if stop.requested:
                for job in active:
                    self._halt(job, stop.reason or "stopped")
            self._assign()
            for pipe in wait([worker.pipe for worker in self._workers], POLL_SECONDS):
                worker = next(worker for worker in self._workers if worker.pipe is pipe)
                self._receive(worker, feed)
            for job in [job for job in active if not self._is_active(job)]:
                active.remove(job)
                feed.ended(job)

    def _is_finished(self, job: Job, seed: int) -> bool:
        """Whether an earlier call of the sweep finished the run; if so, record its results."""
        folder = find_run(self._runner.runs, job.spec.name, job.spec.hash(), seed)
        if folder is None or folder.state().state != "finished":
            return False
        job.record(folder.summary())
        return True

    def _is_active(self, job: Job) -> bool:
        return any(worker.job is job for worker in self._workers) or any(one is job for one, _ in self._waiting)

    def _assign(self) -> None:
        idle = [worker for worker in self._workers if worker.job is None]
        for _ in range(min(self._size - len(self._workers), len(self._waiting) - len(idle))):
            idle.append(self._start_worker())
        for worker in idle:
            if worker.ready and self._waiting:
                worker.job, worker.seed = self._waiting.popleft()
                _send(worker, Begin(worker.seed, worker.job.spec.dump()))

    def _start_worker(self) -> _Worker:
        used = {worker.lock for worker in self._workers}
        locks = (self._locks / f"{number}.lock" for number in range(self._size))
        lock = next(lock for lock in locks if lock not in used)
        worker = _Worker(*start_process(work, lock, self._runner), lock)
        self._workers.append(worker)
        return worker

    def _receive(self, worker: _Worker, feed: Feed) -> None:
        try:
            message = worker.pipe.recv()
        except (EOFError, OSError):  # also in the middle of a message
            self._handle_exit(worker)
            return
        job, seed = worker.job, worker.seed
        if isinstance(message, Ready):
            worker.ready = True
        if job is None:
            return
        if isinstance(message, RunStarted):
            job.read_tests(seed, message.folder)
        elif isinstance(message, RunTested):
            job.tests.setdefault(seed, {})[message.result.steps] = message.result
        elif isinstance(message, RunAdvanced):
            job.steps[seed] = min(message.steps, job.spec.training.steps)
            self._listener(TrialAdvanced(job.spec.name, job.fraction))
        elif isinstance(message, RunWarned):
            self._listener(message)
        elif isinstance(message, RunSummary):
            job.record(message)
            self._listener(TrialAdvanced(job.spec.name, job.fraction))
            worker.job = None
        elif isinstance(message, Refused):
            worker.job = None
        self._stop_if_needed(job, message, feed)

    def _stop_if_needed(self, job: Job, message: object, feed: Feed) -> None:
        """Stop a job if one of its runs failed or the feed stops it."""
        error = message.error if isinstance(message, Refused | RunSummary) else None
        if error is not None and not job.halted:
            job.error = error
            self._halt(job, "another run of this trial failed")
        elif isinstance(message, RunTested) and not job.halted:
            reason = feed.tested(job)
            if reason is not None:
                self._halt(job, reason)

    def _halt(self, job: Job, reason: str) -> None:
        if job.halted:
            return
        job.halted = reason
        self._waiting = deque((one, seed) for one, seed in self._waiting if one is not job)
        for worker in self._workers:
            if worker.job is job:
                _send(worker, Halt(reason))

    def _handle_exit(self, worker: _Worker) -> None:
        """Handle the death of a process: resume its run once."""
        worker.process.join()
        worker.pipe.close()
        self._workers.remove(worker)
        how, job = exit_cause(worker.process), worker.job
        if not worker.ready:
            raise MachineError(f"a worker process {how} before it was ready", hint="see its output above")
        if job is None or job.halted:
            return
        job.deaths[worker.seed] = job.deaths.get(worker.seed, 0) + 1
        if job.deaths[worker.seed] < MAX_DEATHS:
            self._waiting.appendleft((job, worker.seed))
            return
        job.error = f"the process of seed {worker.seed} {how}, for the second time"
        self._halt(job, "another run of this trial failed")


def _send(worker: _Worker, message: Begin | Halt) -> None:
    with suppress(BrokenPipeError, ConnectionResetError):  # `run` notices that it has died
        worker.pipe.send(message)


def work(pipe: Connection, lock: Path, runner: SeedRunner) -> None:
    """Execute runs until the parent closes the pipe or ends."""
    life = FileLock(lock)
    if not life.acquire(_LOCK_SECONDS):
        raise SystemExit(f"{lock} is held by another process")
    with stop_on_signals(interrupt=False) as stop:

        def send(event: RunEvent) -> None:
            try:
                pipe.send(event)
                while pipe.poll():
                    message = pipe.recv()
                    if isinstance(message, Halt):
                        stop.program_reason = message.word
            except (BrokenPipeError, ConnectionResetError, EOFError):  # the parent has ended: stop as after SIGTERM
                stop.signal = signal.SIGTERM

        try:
            pipe.send(Ready())
            while stop.signal is None:
                message = pipe.recv()
                if isinstance(message, Begin):  # otherwise a Halt for a run that has ended
                    stop.program_reason = None
                    pipe.send(_outcome(replace(runner, resolved=message.spec), message.seed, send, stop))
        except (BrokenPipeError, ConnectionResetError, EOFError):
            pass
    life.release()


def _outcome(
    runner: SeedRunner, seed: int, tell: Callable[[RunEvent], None], stop: StopRequest
) -> RunSummary | Refused:
    try:
        check_parts(spec_from_dict(runner.resolved))
        return runner(seed, tell, stop)
    except KarolosError as error:
        return Refused(str(error))
