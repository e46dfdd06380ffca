"""Seeds side by side: one process each, several at a time; the parent passes on what they say."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol

from ..records.run_records import RunSummary
from .events import Listener, RunEnded, RunEvent, RunStarted
from .signals import StopRequest, stop_on_signals

POLL_SECONDS = 0.2
"""How long a request to stop may wait to be noticed by the parent."""


class Work(Protocol):
    """Runs one seed; importable by name, since it is called in a new process."""

    def __call__(self, seed: int, tell: Listener, stop: StopRequest) -> RunSummary: ...


@dataclass
class _Job:
    process: Any
    messages: Connection
    run: str | None = None
    summary: RunSummary | None = None


def run_side_by_side(
    work: Work, seeds: Sequence[int], jobs: int, tell: Listener, stop: StopRequest
) -> list[RunSummary]:
    """Run every seed, `jobs` at a time, and return the summaries of those that got as far as having one.

    A request to stop reaches the running processes as SIGTERM (checkpoint, then stop); no further seed begins.
    """
    waiting = list(seeds)
    running: list[_Job] = []
    found: list[RunSummary] = []
    told = False
    while waiting or running:
        if stop.asked and not told:
            told = True
            waiting.clear()
            for job in running:
                job.process.terminate()
        while waiting and len(running) < jobs:
            running.append(_start(work, waiting.pop(0)))
        for connection in wait([job.messages for job in running], POLL_SECONDS):
            job = next(job for job in running if job.messages is connection)
            if not _hear(job, tell):
                running.remove(job)
                _finish(job, tell)
                if job.summary is not None:
                    found.append(job.summary)
    return found


def _start(work: Work, seed: int) -> _Job:
    context = multiprocessing.get_context("spawn")
    receiving, sending = context.Pipe(duplex=False)
    process = context.Process(target=_in_process, args=(work, seed, sending))
    with sigint_ignored():  # inherited by the child: Ctrl-C reaches the parent, which decides
        process.start()
    sending.close()
    return _Job(process, receiving)


@contextmanager
def sigint_ignored() -> Iterator[None]:
    """Processes started in the block ignore SIGINT."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _hear(job: _Job, tell: Listener) -> bool:
    """Pass on one message; False once there will be no more."""
    try:
        message = job.messages.recv()
    except EOFError:
        return False
    if isinstance(message, RunSummary):
        job.summary = message
        return True
    if isinstance(message, RunStarted):
        job.run = message.run
    tell(message)
    return True


def _finish(job: _Job, tell: Listener) -> None:
    job.process.join()
    job.messages.close()
    if job.summary is None and job.run is not None:
        code = job.process.exitcode
        how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
        tell(RunEnded(job.run, "lost", f"its process {how}"))


def _in_process(work: Work, seed: int, sending: Connection) -> None:
    with stop_on_signals(interrupt=False) as stop:

        def tell(event: RunEvent) -> None:
            try:
                sending.send(event)
            except BrokenPipeError:  # the parent is gone: nobody listens, so end like after SIGTERM
                stop.signal = signal.SIGTERM

        summary = work(seed, tell, stop)
        sending.send(summary)
    sending.close()
