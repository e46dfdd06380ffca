"""A crew of worker processes and the jobs it carries out: what is imported once serves a whole sweep."""

from __future__ import annotations

import multiprocessing
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

from ..errors import MachineError
from ..experiment.events import RunStarted, RunTested, RunWarned
from ..experiment.experiment import SeedRunner
from ..experiment.jobs import POLL_SECONDS, sigint_ignored
from ..experiment.resume import find_run
from ..experiment.signals import StopRequest
from ..records import RunFolder
from ..records.results import TestResult
from ..records.run_records import RunSummary
from ..spec import Spec
from .worker import Begin, Halt, Ready, Refused, work

PATIENCE = 2
"""Processes that may die on a run before it counts as failed; the second goes on from the checkpoint of the first."""


@dataclass(eq=False)
class Job:
    """A spec on several seeds, and how far it has come."""

    spec: Spec
    tests: dict[int, dict[int, TestResult]] = field(default_factory=dict)
    """Seed -> steps -> test."""
    summaries: dict[int, RunSummary] = field(default_factory=dict)
    error: str | None = None
    """Why it failed: the first run's that did."""
    halted: str | None = None
    """Why its runs were told to stop."""
    deaths: dict[int, int] = field(default_factory=dict)
    """Seed -> processes that died on it."""

    @property
    def finished(self) -> bool:
        """Whether every run came to its end."""
        return len(self.summaries) == len(self.spec.seeds) and all(
            summary.state == "finished" for summary in self.summaries.values()
        )

    def results(self) -> dict[int, list[TestResult]]:
        """Seed -> its tests in order, in the order of the seeds."""
        return {seed: [test for _, test in sorted(self.tests.get(seed, {}).items())] for seed in self.spec.seeds}

    def take(self, summary: RunSummary) -> None:
        """A run of the job has come to an end."""
        self.summaries[summary.seed] = summary
        self.read_tests(summary.seed, summary.folder)

    def read_tests(self, seed: int, folder: str) -> None:
        """Take the tests that stand in a run's folder, which are those of a run that goes on, too."""
        found = RunFolder.open(folder).tests()
        self.tests.setdefault(seed, {}).update({test.steps: test for test in found})


class Feed(Protocol):
    """Where a crew's jobs come from, and what is done with them."""

    def next(self) -> Job | None:
        """Another job to begin now; None while there is none."""

    def tested(self, job: Job) -> str | None:
        """Every seed of the job may have one test more; a word to stop its runs with, or None."""

    def ended(self, job: Job) -> None:
        """No run of the job goes on."""

    def warned(self, event: RunWarned) -> None:
        """A run can go on, but not as it should."""


@dataclass
class _Worker:
    process: Any
    pipe: Connection
    lock: Path
    ready: bool = False
    job: Job | None = None
    seed: int = 0


class Crew:
    """Worker processes that carry out jobs; use it in a `with`.

    Args:
        size: processes at the same time.
        locks: folder of their lock files.
        runner: how runs are carried out; each is handed a spec of its own.
    """

    def __init__(self, size: int, locks: Path, runner: SeedRunner) -> None:
        self._size = size
        self._locks = locks
        self._runner = runner
        self._workers: list[_Worker] = []
        self._waiting: deque[tuple[Job, int]] = deque()

    def __enter__(self) -> Crew:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for worker in self._workers:
            worker.pipe.close()  # which tells it to end
        for worker in self._workers:
            worker.process.join()

    def run(self, feed: Feed, stop: StopRequest) -> None:
        """Carry out the feed's jobs until it has no more; a request to stop leaves their runs with a checkpoint."""
        active: list[Job] = []
        while True:
            while not stop.requested and (job := feed.next()) is not None:
                active.append(job)
                self._waiting.extend((job, seed) for seed in job.spec.seeds if not self._is_there(job, seed))
            if not active:
                return
            if stop.requested:
                for job in active:
                    self._halt(job, stop.reason or "stopped")
            self._assign()
            for pipe in wait([worker.pipe for worker in self._workers], POLL_SECONDS):
                worker = next(worker for worker in self._workers if worker.pipe is pipe)
                self._hear(worker, feed)
            for job in [job for job in active if not self._goes_on(job)]:
                active.remove(job)
                feed.ended(job)

    def _is_there(self, job: Job, seed: int) -> bool:
        """Whether the run is finished already, as in a sweep that was interrupted; the job then has its results."""
        found = find_run(self._runner.runs, job.spec.name, job.spec.hash(), seed)
        if found is None or found.state().state != "finished":
            return False
        job.take(found.summary())
        return True

    def _goes_on(self, job: Job) -> bool:
        return any(worker.job is job for worker in self._workers) or any(one is job for one, _ in self._waiting)

    def _assign(self) -> None:
        idle = [worker for worker in self._workers if worker.job is None]
        for _ in range(min(self._size - len(self._workers), len(self._waiting) - len(idle))):
            idle.append(self._hire())
        for worker in idle:
            if worker.ready and self._waiting:
                worker.job, worker.seed = self._waiting.popleft()
                _send(worker, Begin(worker.seed, worker.job.spec.dump()))

    def _hire(self) -> _Worker:
        taken = {worker.lock.name for worker in self._workers}
        lock = next(self._locks / f"{place}.lock" for place in range(self._size) if f"{place}.lock" not in taken)
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=work, args=(theirs, lock, self._runner))
        with sigint_ignored():  # inherited by the child: Ctrl-C reaches the parent, which decides
            process.start()
        theirs.close()
        worker = _Worker(process, ours, lock)
        self._workers.append(worker)
        return worker

    def _hear(self, worker: _Worker, feed: Feed) -> None:
        try:
            message = worker.pipe.recv()
        except (EOFError, OSError):  # at a message's end, or in the middle of one
            self._bury(worker)
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
        elif isinstance(message, RunWarned):
            feed.warned(message)
        elif isinstance(message, RunSummary):
            job.take(message)
            worker.job = None
        elif isinstance(message, Refused):
            worker.job = None
        self._judge(job, message, feed)

    def _judge(self, job: Job, message: object, feed: Feed) -> None:
        """Stop a job of which a run has failed, or which the feed gives up."""
        error = message.error if isinstance(message, Refused | RunSummary) else None
        if error is not None and not job.halted:
            job.error = error
            self._halt(job, "another run of this trial failed")
        elif isinstance(message, RunTested) and not job.halted:
            word = feed.tested(job)
            if word is not None:
                self._halt(job, word)

    def _halt(self, job: Job, word: str) -> None:
        if job.halted:
            return
        job.halted = word
        self._waiting = deque((one, seed) for one, seed in self._waiting if one is not job)
        for worker in self._workers:
            if worker.job is job:
                _send(worker, Halt(word))

    def _bury(self, worker: _Worker) -> None:
        """A process has died: its run is begun again where it was, once."""
        worker.process.join()
        worker.pipe.close()
        self._workers.remove(worker)
        code, job = worker.process.exitcode, worker.job
        how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
        if not worker.ready:
            raise MachineError(f"a worker process {how} before it could begin", hint="its own words stand above")
        if job is None or job.halted:
            return
        job.deaths[worker.seed] = job.deaths.get(worker.seed, 0) + 1
        if job.deaths[worker.seed] < PATIENCE:
            self._waiting.appendleft((job, worker.seed))
            return
        job.error = f"the process of seed {worker.seed} {how}, for the second time"
        self._halt(job, "another run of this trial failed")


def _send(worker: _Worker, message: Begin | Halt) -> None:
    with suppress(BrokenPipeError, ConnectionResetError):  # it has died, which is heard at the other end of the pipe
        worker.pipe.send(message)
